"""Faults of order: a request that was sent before a hold arrives after it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

from pcmrs.client import Client
from pcmrs.testing.arm import BRAKING, standing
from pcmrs.testing.cell import QUICK, REAL_TIME, RunningCell
from pcmrs.testing.driving import (
    PATIENCE,
    accept,
    landmarks,
    moving,
    reason_text,
    reset_cell,
    showing,
    state,
    to_placed,
    to_retracted,
    to_standoff,
    until,
)
from pcmrs_lab.campaign.checks import confirmed, expect, held
from pcmrs_lab.campaign.delays import Delayed, Place, Rule, delays_of
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab

LATE = 0.25
"""Delay of a late frame, s of the machine: longer than a resting arm takes to confirm a hold, less than the age at
which a device refuses a request by its age alone."""

LATER = 0.9
"""Delay of a frame that arrives after the next command has begun, s of the machine."""

LOOKS = 20

ROBOT = "dev/robot/cmd"
STIMULATOR = "dev/stimulator/cmd"
ON_ITS_WAY = "the bus delivers the request late, after the hold"

Prepare = Callable[[Client], Awaitable[None]]


def delayed(response: str, late: list[Delayed], moved: list[float] | None = None, **control: Any) -> Evidence:
    """Return the evidence of a row: records of the delayed process, motion of the arm, and result of the control.

    Args:
        response: Response in a few words.
        late: Records of the delayed frames.
        moved: Largest displacement of a joint, rad; None if it was not measured.
        control: Results of the control, by name.
    """
    found = {"delayed": len(late), "late_s": [round(each.ended - each.begun, 3) for each in late]}
    details: dict[str, Any] = {"overtaken_by": sum(each.overtaken for each in late)}
    if moved is not None:
        details["moved_deg"] = round(math.degrees(moved[0]), 3)
    return Evidence(response, took_place=found, control_kind="without_fault", control=control, details=details)


async def late_motion(
    lab: Lab,
    place: Place,
    prepare: Prepare,
    name: str,
    arguments: dict[str, Any] | None = None,
    *,
    word: str = "follow",
    blocked: float = 0.0,
) -> Evidence:
    """Press Stop while a motion's request is in transit; the request arrives after the hold, and must move nothing.

    Args:
        lab: Surroundings of the fault.
        place: Point at which the request is delayed.
        prepare: Brings the cell to a state in which the motion may begin.
        name: Motion, ``branch.operation``.
        arguments: Arguments of the motion.
        word: Method of the request.
        blocked: Time for which the daemon's loop is blocked when Stop comes, s, so that only the node itself holds.

    Returns:
        Evidence of the row.

    Raises:
        Unmet: A joint has moved, or the motion did not work when it was requested again.
    """
    rule = Rule(place, ROBOT, word, LATE)
    blocking = [Rule("pass", "service.before_publish", seconds=blocked)] if blocked else []
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await prepare(cell.client)
        await asyncio.sleep(BRAKING)
        async with delays_of(cell).delaying(rule):
            motion = asyncio.create_task(cell.client.call(name, arguments, timeout=PATIENCE))
            await delays_of(cell).wait_until_delaying(rule)
            async with standing(cell) as moved, delays_of(cell).delaying(*blocking):
                await cell.client.stop()
                late = await delays_of(cell).wait_until_delayed(rule)
                verdict = await motion
            await held(cell)
        await confirmed(cell)
        await prepare(cell.client)
        async with moving(cell.client, name, arguments=arguments) as control:
            again = await control
        expect(again.decision == "accepted", f"{name} was {again.decision} when it was requested again.")
        await start_over(cell)
    expect(verdict.decision in ("failed", "accepted"), f"{name} ended {verdict.decision}: {reason_text(verdict)}.")
    return delayed("no joint moved", late, moved, moved_the_arm_when_asked_again=again.decision)


async def start_over(cell: RunningCell) -> None:
    """Stop following, if the tool still follows, so that the next row finds a resting arm."""
    if (await state(cell.client, "placement")) == "following":
        await accept(cell.client, "placement.stop_following")


@fault("Q1", how="the thread that sends the request of an approach is slow")
async def sent_late(lab: Lab) -> Evidence:
    """The daemon's own thread sends `follow` after the hold."""
    return await late_motion(lab, "send", to_retracted, "placement.approach")


@fault("Q1", how=ON_ITS_WAY)
async def delivered_late(lab: Lab) -> Evidence:
    """`follow` is in transit for longer than the hold that was sent after it."""
    return await late_motion(lab, "receive", to_retracted, "placement.approach")


@fault(
    "Q2", how="the daemon's loop stands still, so that the node alone holds, on the lane of Stop; `follow` arrives then"
)
async def after_the_node_s_own_hold(lab: Lab) -> Evidence:
    """The node's own hold counts like the daemon's."""
    return await late_motion(lab, "receive", to_retracted, "placement.approach", blocked=2 * LATE)


@fault("Q11", how=ON_ITS_WAY)
async def confirm_late(lab: Lab) -> Evidence:
    """The late request is the motion to the body."""
    return await late_motion(lab, "receive", to_standoff, "placement.confirm")


@fault("Q12", how=ON_ITS_WAY)
async def nudge_late(lab: Lab) -> Evidence:
    """The late request is a small motion at the body."""
    nudge = {"translation": [0.0, 0.0, 0.004]}
    return await late_motion(lab, "receive", to_placed, "placement.nudge", nudge)


@fault("Q13", how=ON_ITS_WAY)
async def retreat_late(lab: Lab) -> Evidence:
    """A motion away from the body is stopped like any other."""
    return await late_motion(lab, "receive", to_standoff, "placement.home")


@fault("Q14", how=ON_ITS_WAY)
async def servo_late(lab: Lab) -> Evidence:
    """The late request begins a servo session, for following the head."""
    rule = Rule("receive", ROBOT, "begin_servo", LATE)
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_placed(cell.client)
        await asyncio.sleep(BRAKING)
        async with delays_of(cell).delaying(rule):
            follow = asyncio.create_task(cell.client.call("placement.follow", timeout=PATIENCE))
            await delays_of(cell).wait_until_delaying(rule)
            await cell.client.stop()
            await until(cell.client, lambda shown: shown.latched and shown.branches["placement"] != "following")
            async with standing(cell) as moved:
                late = await delays_of(cell).wait_until_delayed(rule)
            await follow
            await held(cell)
        await confirmed(cell)
        await to_placed(cell.client)
        await accept(cell.client, "placement.follow")
        shown = await until(cell.client, showing(placement="following"))
        await start_over(cell)
    return delayed("no servo session begins", late, moved, asked_again=shown.branches["placement"])


@fault(
    "Q15", how="the bus delivers the request of the stopped motion while the next one, after the acknowledgement, runs"
)
async def overtaken_by_the_next(lab: Lab) -> Evidence:
    """Only the motion that was requested after the acknowledgement is performed."""
    rule = Rule("receive", ROBOT, "follow", LATER)
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_standoff(cell.client)
        await asyncio.sleep(BRAKING)
        async with delays_of(cell).delaying(rule):
            stopped = asyncio.create_task(cell.client.call("placement.confirm", timeout=PATIENCE))
            await delays_of(cell).wait_until_delaying(rule)
            await cell.client.stop()
            await stopped
            shown = await until(cell.client, lambda shown: shown.latched and not shown.stop.pending)
            await accept(cell.client, "robot.acknowledge", stop=shown.stop.number)
            verdict = await cell.client.call("placement.back_off", timeout=PATIENCE)
            async with standing(cell) as moved:
                late = await delays_of(cell).wait_until_delayed(rule)
        expect(verdict.decision == "accepted", f"back_off was {verdict.decision}: {reason_text(verdict)}.")
        where = await state(cell.client, "placement")
        expect(where in ("standoff", "retracted"), f"The placement is {where} after back_off.")
    return delayed("the next motion was done, and no other", late, moved, back_off=verdict.decision, reached=where)


THRESHOLD = ("workflow=ratms_threshold", *REAL_TIME)


async def ready_to_stimulate(client: Client) -> None:
    """Bring the tool to its pose, and set ceiling and intensity, so that the stimulator may be armed."""
    await to_placed(client)
    await accept(client, "stimulation.set_ceiling", percent=80.0, operator="simulated operator")
    await accept(client, "stimulation.set_intensity", percent=50.0)


async def late_stimulation(lab: Lab, method: str, name: str, arguments: dict[str, Any]) -> Evidence:
    """Press Stop while a request to the stimulator is in transit; it must have no effect when it arrives.

    Args:
        lab: Surroundings of the fault.
        method: Method of the request.
        name: Operation, ``branch.operation``.
        arguments: Arguments of the operation.

    Returns:
        Evidence of the row.
    """
    rule = Rule("receive", STIMULATOR, method, LATE)
    async with lab.cell(*THRESHOLD, delayed=True) as cell:
        await ready_to_stimulate(cell.client)
        before = await cell.client.request_device("stimulator", "state")
        async with delays_of(cell).delaying(rule):
            asked = asyncio.create_task(cell.client.call(name, arguments, timeout=PATIENCE))
            await delays_of(cell).wait_until_delaying(rule)
            await cell.client.stop()
            late = await delays_of(cell).wait_until_delayed(rule)
            verdict = await asked
            await asyncio.sleep(BRAKING)
            after = await cell.client.request_device("stimulator", "state")
        expect(verdict.decision != "accepted", f"{name} was accepted after Stop.")
        expect(not after["armed"], "The stimulator is armed after Stop.")
        expect(after["intensity"] == before["intensity"], f"The intensity has changed: {before} became {after}.")
        await confirmed(cell)
        await ready_to_stimulate(cell.client)
        again = await accept(cell.client, name, **arguments)
        effect = await cell.client.request_device("stimulator", "state")
        changed = [each for each in ("armed", "intensity") if effect[each] != before[each]]
        expect(bool(changed), f"{name} has no effect when it is requested again either.")
        await accept(cell.client, "stimulation.disarm")
    return delayed("disarmed, unchanged", late, asked_again=again.decision, changed=changed)


@fault("Q16", how=ON_ITS_WAY, deadline=240.0)
async def arming_late(lab: Lab) -> Evidence:
    """The stimulator is not armed after Stop."""
    return await late_stimulation(lab, "arm", "stimulation.arm", {})


@fault("Q17", how=ON_ITS_WAY, deadline=240.0)
async def intensity_late(lab: Lab) -> Evidence:
    """The intensity does not change after Stop."""
    return await late_stimulation(lab, "set_intensity", "stimulation.set_intensity", {"percent": 60.0})


@fault("Q18", how=ON_ITS_WAY)
async def touch_late(lab: Lab) -> Evidence:
    """A simulated hand that was stopped touches nothing afterwards."""
    rule = Rule("receive", "dev/pointer/cmd", "touch", LATE)
    async with lab.cell(*QUICK, delayed=True) as cell:
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
        before = (await cell.scene.truth()).tip_in_tracker
        async with delays_of(cell).delaying(rule):
            asked = asyncio.create_task(cell.client.call("digitization.digitize_one", {"index": 0}, timeout=PATIENCE))
            await delays_of(cell).wait_until_delaying(rule)
            await cell.client.stop()
            verdict = await asked
            late = await delays_of(cell).wait_until_delayed(rule)
            seen = await _tips(cell)
        expect(verdict.decision == "failed", f"digitize_one ended {verdict.decision}: {reason_text(verdict)}.")
        expect(set(seen) == {before}, f"The hand was at {before}, and after Stop at {set(seen)}.")
        await reset_cell(cell.client)
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
        again = await accept(cell.client, "digitization.digitize_one", index=0)
    spreads = {name: round(spread * 1e3, 3) for name, spread in (again.result or {})["spreads"].items()}
    return delayed("the hand rests", late, asked_again=again.decision, touched_with_spread_mm=spreads)


async def _tips(cell: RunningCell) -> list[tuple[float, ...] | None]:
    """Return positions of the pointer's tip during `BRAKING` in the tracker frame, m; None while the hand is away."""
    seen: list[tuple[float, ...] | None] = []
    for _ in range(LOOKS):
        seen.append((await cell.scene.truth()).tip_in_tracker)
        await asyncio.sleep(BRAKING / LOOKS)
    return seen
