"""Faults of the wall clock: it is set, stands still, differs between hosts, or the machine sleeps."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Awaitable, Sequence
from functools import partial
from typing import Any

from pcmrs.bus.commands import Envelope
from pcmrs.bus.keys import command_key
from pcmrs.clock import SystemClock
from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Verdict
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import PATIENCE, moving, plan, register, state, until
from pcmrs.threads import descendants
from pcmrs_lab.campaign import walltime
from pcmrs_lab.campaign.checks import confirmed, expect, held, shape
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.samples import process_state
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.walltime import WallClock

SET = "a library in daemon and nodes that shifts the wall clock of the C library"
HOUR, DAY = 3600.0, 86400.0
SLOW = ("procedure.motion.linear_velocity=0.03", "robot.deadman=0.5")
OVERLOAD = ("loop_stalled", "daemon_silent")
MOMENT = 5.0
"""A wall clock used as the monotonic one would show a larger error than this, s."""
SLEEP = 6.0
"""Time for which the machine sleeps, s; longer than every deadline of a link."""


@fault("C1", how=SET, needs=walltime.NEEDS)
async def the_wall_clock_goes_back(lab: Lab) -> Evidence:
    """The wall clock goes back by an hour in the middle of a motion."""
    return await _set_in_motion(lab, -HOUR)


@fault("C2", how=SET, needs=walltime.NEEDS)
async def the_wall_clock_leaps_ahead(lab: Lab) -> Evidence:
    """The wall clock leaps ahead by ten days in the middle of a motion."""
    return await _set_in_motion(lab, 10 * DAY)


@fault("C3", how=SET, needs=walltime.NEEDS)
async def the_wall_clock_stands(lab: Lab) -> Evidence:
    """The wall clock stands still from the middle of a motion on."""
    return await _set_in_motion(lab, None)


@fault("C4", how="commands with the stamps of another host's clock, over the bus")
async def the_clocks_of_two_hosts_differ(lab: Lab) -> Evidence:
    """A command without a stamp is accepted at any clock; one with a time limit is refused if it is not fresh."""
    decided: dict[str, str] = {}
    async with lab.cell() as cell:
        before = await cell.client.state()
        for ahead in (-10 * DAY, -HOUR, HOUR, 10 * DAY):
            limited = await _command(cell, sent=SystemClock().wall() + (0.0 if is_sham() else ahead), ttl=5.0)
            code = limited.reason.code if limited.reason is not None else ""
            expect(limited.decision == "rejected" and code == "expired", f"{ahead:+.0f} s: {limited.decision} {code}.")
            decided[f"{ahead:+.0f} s, with a limit"] = code
        expect(shape(await cell.client.state()) == shape(before), "The state has changed.")
        fresh = await _command(cell, sent=SystemClock().wall(), ttl=5.0)
        expect(fresh.decision == "accepted", f"With a stamp of now it was {fresh.decision}.")
        unstamped = await _command(cell)
        expect(unstamped.decision == "accepted", f"Without a stamp it was {unstamped.decision}.")
        await cell.planner.plan_landmarks([landmark.position for landmark in plan().landmarks])
        await _stop_works(cell)
    return Evidence(
        "stamps beyond their limit are refused; everything else, and Stop, ignores them",
        took_place=decided,
        control_kind="without_fault",
        control={"with a stamp of now": fresh.decision, "without a stamp": unstamped.decision},
    )


@fault("C5", how="SIGSTOP of daemon and nodes together for 6 s, in motion")
async def the_machine_sleeps(lab: Lab) -> Evidence:
    """Nothing continues by itself afterwards: the motion is held, and old commands are refused."""
    async with lab.daemon(*SLOW) as cell:
        await register(cell.client)
        wall = SystemClock().wall()
        async with moving(cell.client) as verdict:
            everybody = [cell.process.pid, *descendants(cell.process.pid)]
            inject_unless_sham(lambda: _signal(everybody, signal.SIGSTOP))
            late = asyncio.create_task(_late_command(cell, wall))
            await asyncio.sleep(SLEEP)
            asleep = sum(is_stopped(pid) for pid in everybody)
            _signal(everybody, signal.SIGCONT)
            ended = await _decision(verdict)
        expect(ended != "accepted", "The approach was accepted after the sleep.")
        await held(cell, ("held", "unknown"))
        old = await late
        expect(old != "accepted", "A command from before the sleep was accepted after it.")
        if await state(cell.client, "placement") == "held":
            await confirmed(cell)
        fresh = await _command(cell, sent=SystemClock().wall(), ttl=SLEEP / 2)
        expect(fresh.decision == "accepted", f"Without the sleep it was {fresh.decision}: {fresh.reason}")
    return Evidence(
        "held; old commands are refused",
        took_place={"processes seen stopped": asleep, "of": len(everybody)},
        control_kind="without_fault",
        control={"the old command, sent again": fresh.decision},
        details={"approach": ended, "old command": old},
    )


async def _late_command(cell: RunningCell, wall: float) -> str:
    return await _decision(_command(cell, sent=wall, ttl=SLEEP / 2))


async def _decision(verdict: Awaitable[Verdict]) -> str:
    """Return the decision on a command; a client that was asleep may have lost its connection."""
    try:
        return (await verdict).decision
    except UnknownOutcomeError:
        return "no verdict"


async def _set_in_motion(lab: Lab, ahead: float | None) -> Evidence:
    """Set the wall clock in motion: this motion, and those started after it, end as usual."""
    clock = WallClock.create(lab.folder / "wall")
    async with lab.daemon(*REAL_TIME, "robot.deadman=1", environment=clock.environment()) as cell:
        await register(cell.client)
        row = cell.last_row()
        async with moving(cell.client) as verdict:
            inject_unless_sham(partial(_set, clock, ahead))
            ended = await verdict
        _expect_undisturbed(ended)
        await _by_planner(cell)
        over_bus = await _command(cell, "placement", "home")
        _expect_undisturbed(over_bus)
        await _stop_works(cell)
        entries = cell.rows(row)
    stamps = [entry.wall for entry in entries]
    expect(_is_set(stamps, ahead), f"The daemon's wall clock was not set: {stamps}.")
    stood = [entry.monotonic for entry in entries if entry.wall == stamps[-1]]
    took_place = (
        {"the journal has one stamp for_s": stood[-1] - stood[0]}
        if ahead is None
        else {"stamps of the journal are set by_s": stamps[-1] - stamps[0]}
    )
    return Evidence(
        "nothing was decided by it",
        took_place=took_place,
        control_kind="without_fault",
        control={"a motion with the clock set": ended.decision, "stamped rightly before": stamps[0]},
        details={"stamps": [stamps[0], stamps[-1]]},
    )


def _set(clock: WallClock, ahead: float | None) -> None:
    if ahead is None:
        clock.freeze()
    else:
        clock.shift(ahead)


def _expect_undisturbed(verdict: Verdict) -> None:
    """Check that a motion has ended as usual.

    Raises:
        Unmet: It has not.
        NotRun: It was held because the machine was too busy for a moment, which shows nothing about the wall clock.
    """
    reason = verdict.reason
    if reason is not None and reason.code in OVERLOAD:
        moment = max((value for value in reason.fields.values() if isinstance(value, float)), default=0.0)
        if moment < MOMENT:
            raise NotRun(f"The machine does too much else: {reason.text}")
    expect(verdict.decision == "accepted", f"{verdict.operation} was {verdict.decision}: {reason}")


def _is_set(stamps: Sequence[float], ahead: float | None) -> bool:
    """Return whether the stamps show that the clock was set."""
    now = SystemClock().wall()
    if ahead is None:
        return len(stamps) > 1 and stamps[-1] == stamps[-2]
    return abs(stamps[-1] - now - ahead) < 60.0 and abs(stamps[0] - now) < 600.0


async def _by_planner(cell: RunningCell) -> None:
    """Check that string commands, which carry no stamps, are accepted."""
    verdict = await cell.planner.command("get_jnt_angsxxxx", timeout=PATIENCE)
    expect(verdict.decision == "accepted", f"Over UDP it was {verdict.decision}.")


async def _stop_works(cell: RunningCell) -> None:
    """Check that Stop latches, and that its latch can be released."""
    await cell.client.stop()
    await until(cell.client, lambda shown: shown.latched and shown.stop.confirmed)
    if await state(cell.client, "robot") == "1":
        number = (await cell.client.state()).stop.number
        released = await _command(cell, "robot", "acknowledge", arguments={"stop": number})
        expect(released.decision == "accepted", f"acknowledge was {released.decision}: {released.reason}")


async def _command(cell: RunningCell, branch: str = "toolplan", operation: str = "reinit", **fields: Any) -> Verdict:
    """Send a request without a stamp, unless `fields` contain one."""
    key = command_key("local", branch, operation)
    return await cell.bus.request(key, Envelope(**fields), Verdict, PATIENCE)


def is_stopped(pid: int) -> bool:
    """Return whether the kernel reports a process as stopped; one that has ended is not."""
    try:
        return process_state(pid) == "T"
    except FileNotFoundError:
        return False


def _signal(pids: Sequence[int], number: int) -> None:
    for pid in pids:
        os.kill(pid, number)
