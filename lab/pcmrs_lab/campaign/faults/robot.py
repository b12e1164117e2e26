"""Robot faults, injected into the simulated arm, its link or its virtual cabinet."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np

from pcmrs.bus.commands import Envelope
from pcmrs.bus.keys import command_key
from pcmrs.clock import SystemClock
from pcmrs.messages import JointSetpoint, Verdict
from pcmrs.testing.arm import stands, tool_position
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import (
    accept,
    connect,
    moving,
    reason_text,
    state,
    to_placed,
    to_retracted,
    to_standoff,
    until,
    wait_until_stationary,
)
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.checks import check_refused, confirmed, expect, held, refused
from pcmrs_lab.campaign.driving import FOLLOWED, injected, to_following
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.receivers import SS, DroppedSetpoints, Segments, dropped_setpoints, segments
from pcmrs_lab.campaign.robot_signs import robot_reports
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham

HOW = "simulated arm of a running cell, in motion"
SETTLING = 0.8
"""Time after a fault has ended in which a motion that continues by itself would begin, s of the machine."""


async def braked(
    lab: Lab, name: str, begin: dict[str, Any] | None = None, end: dict[str, Any] | None = None
) -> Evidence:
    """Check that a motion fails, the tool is held, and nothing continues until an operator confirms.

    Args:
        lab: Surroundings of the fault.
        name: Name of the fault of the simulated scene.
        begin: Arguments that inject it, as for `injected`.
        end: Arguments that end it, as for `injected`.

    Returns:
        Evidence of the row.
    """
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        async with robot_reports(cell) as robot, moving(cell.client) as approach, injected(cell, name, begin, end):
            verdict = await approach
            _expect_end(verdict, ("failed", "held"))
            await held(cell)
            took_place = robot.shown(name)
        await asyncio.sleep(SETTLING)
        await held(cell)
        await confirmed(cell)
        async with moving(cell.client) if await _retracted(cell) else moving(cell.client, "placement.home") as again:
            pass
    expect(again.result().decision == "accepted", f"Without the fault a motion was {again.result().decision}.")
    return Evidence(
        "motion failed, held and latched until confirmed",
        took_place=took_place,
        control_kind="without_fault",
        control={"the next motion, without the fault": again.result().decision},
    )


async def _retracted(cell: RunningCell) -> bool:
    return (await cell.client.state()).branches["placement"] == "retracted"


def _expect_end(verdict: Verdict, *endings: tuple[str, str]) -> None:
    seen = f"The operation ended {verdict.decision} in {verdict.state} ({reason_text(verdict)})"
    known = " or ".join(" in ".join(ending) for ending in endings)
    expect((verdict.decision, verdict.state) in endings, f"{seen}; expected {known}.")


Endings = tuple[tuple[str, str], ...]
"""Decisions and states with which a motion may end."""

UNKNOWN: Endings = (("unknown", "unknown"),)
REPORTED: Endings = (*UNKNOWN, ("failed", "held"))
"""If the robot reports in time that its application fails, it is known to stand before it is lost."""


async def lost(
    lab: Lab,
    name: str,
    begin: dict[str, Any] | None = None,
    end: dict[str, Any] | None = None,
    endings: Endings = UNKNOWN,
) -> Evidence:
    """Check that the outcome of a motion is unknown, the robot counts as disconnected, and nothing is sent again.

    Args:
        lab: Surroundings of the fault.
        name: Name of the fault of the simulated scene.
        begin: Arguments that inject it, as for `injected`.
        end: Arguments that end it, as for `injected`.
        endings: Permitted decisions and states.

    Returns:
        Evidence of the row.
    """
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        row = cell.last_row()
        async with robot_reports(cell) as robot, moving(cell.client) as approach, injected(cell, name, begin, end):
            _expect_end(await approach, *endings)
            await until(cell.client, lambda shown: shown.latched and shown.branches["robot"] == "0")
            expect((await cell.client.state()).branches["placement"] == "unknown", "The placement counts as known.")
            displacement = await stands(cell)
            took_place = robot.shown(name)
        await connect(cell.client)
        located = await until(cell.client, lambda snapshot: snapshot.branches["placement"] != "unknown")
        expect(located.latched, "The latch was released although nobody confirmed.")
        await stands(cell)
        intents = [stored for stored in cell.rows(row) if (stored.kind, stored.operation) == ("intent", "approach")]
        expect(len(intents) == 1, f"The approach began {len(intents)} times.")
        await confirmed(cell)
        await to_retracted(cell.client)
        control = await accept(cell.client, "placement.approach")
    return Evidence(
        "unknown, disconnected, latched; located again",
        took_place=took_place,
        control_kind="without_fault",
        control={"approach without the fault": control.decision},
        details={"moved_m": displacement, "begun": len(intents)},
    )


@fault("B1", how=f"{HOW}: its link carries nothing any more")
async def cut(lab: Lab) -> Evidence:
    """The link is cut in motion."""
    return await lost(lab, "cut_robot")


@fault("B2", how=f"{HOW}: it obeys but answers nothing")
async def silent(lab: Lab) -> Evidence:
    """No request is answered during a motion."""
    return await lost(lab, "silence_robot")


@fault("B3", how=f'{HOW}: the motion is interrupted, the reply says "interrupted"')
async def interrupted(lab: Lab) -> Evidence:
    """The cabinet interrupts the motion."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        async with moving(cell.client) as approach, injected(cell, "interrupt", {}, {}):
            verdict = await approach
        _expect_end(verdict, ("failed", "held"))
        expect("interrupted" in reason_text(verdict), f"The reason is another one: {reason_text(verdict)}.")
        await stands(cell)
        await accept(cell.client, "placement.back_off")
        control = await accept(cell.client, "placement.approach")
    return Evidence(
        "the operation has failed, the tool is held",
        took_place={"the cabinet's reply": reason_text(verdict)},
        control_kind="without_fault",
        control={"approach without the fault": control.decision},
    )


VIRTUAL = (*REAL_TIME, "robot.driver=kst", "kst.reply_timeout=2.0", "kst.pose_limit=0.3")


@fault(
    "B4",
    how="virtual cabinet over TCP: replies split, merged and mixed in their segments",
    needs=(SS,),
    deadline=240.0,
)
async def framed(lab: Lab) -> Evidence:
    """Motions work with any framing of the replies."""
    seen: dict[str, float] = {}
    async with lab.daemon(*VIRTUAL) as cell:
        await cell.scene.inject("frame_replies", {"how": "whole"})
        try:
            await to_placed(cell.client)
            whole = await _polled(cell)
            control = await _move_there_and_back(cell)
        except Unmet as error:
            raise NotRun(f"On this machine the virtual cabinet fails with whole replies, too: {error.text}") from None
        for framing in ("split", "merged", "mixed"):
            async with injected(cell, "frame_replies", {"how": framing}, {"how": "whole"}):
                seen[framing] = _framed(framing, await _polled(cell), whole)
                await _move_there_and_back(cell)
    return Evidence(
        "back_off and confirm accepted with every framing",
        took_place={
            "segments beside one for a reply, split": seen["split"],
            "segments beside one for a reply, mixed": seen["mixed"],
            "a reply is held back to be merged for_s": seen["merged"],
        },
        control_kind="without_fault",
        control={"confirm with whole replies": control, "segments for a reply": whole.per_request},
    )


POLLED = 2.0
"""Time for which segments are counted while the arm rests and replies to one request after the other, s."""
IN_FLIGHT = 2
"""Number of segments that may be in transit between the counts of sent and received ones."""
HELD_BACK = 0.01
"""Additional delay of a reply that is held back, s."""


async def _polled(cell: RunningCell) -> Segments:
    """Return the segments of the driver's connection while the arm rests."""
    await asyncio.sleep(SETTLING)
    port = int(next(each for each in reversed(cell.settings) if each.startswith("kst.port=")).partition("=")[2])
    before = await segments(port)
    await asyncio.sleep(POLLED)
    return (await segments(port)).since(before)


def _framed(framing: str, seen: Segments, whole: Segments) -> float:
    """Return how replies differ from whole ones: surplus of segments over requests, or additional delay, s.

    Raises:
        Unmet: They do not differ.
    """
    expect(min(seen.received, whole.received) > IN_FLIGHT, f"No replies are counted: {seen}, {whole}.")
    if framing == "merged":
        later = POLLED / seen.received - POLLED / whole.received
        expect(later > HELD_BACK, f"Replies are not held back to be merged: {seen}, whole ones are {whole}.")
        return later
    more = seen.received - seen.sent
    expect(more > IN_FLIGHT, f"Replies do not come in several segments when {framing}: {seen}.")
    return more


async def _move_there_and_back(cell: RunningCell) -> str:
    await accept(cell.client, "placement.back_off")
    await asyncio.sleep(SETTLING)
    return (await accept(cell.client, "placement.confirm")).decision


@fault("B5", how=f"{HOW}: emergency stop")
async def emergency(lab: Lab) -> Evidence:
    """An emergency stop is pressed in motion."""
    return await braked(lab, "e_stop")


@fault("B6", how="simulated scene: the head is moved out of the arm's reach")
async def unreachable(lab: Lab) -> Evidence:
    """The planned pose is out of reach."""
    far = {"millimetres": 1500.0}
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        before = (await cell.scene.truth()).tracker_from_body_ref.position
        async with injected(cell, "shift_body", far, {"millimetres": -1500.0}):
            await asyncio.sleep(1.0)
            shifted = math.dist(before, (await cell.scene.truth()).tracker_from_body_ref.position)
            verdict = await refused(cell, "placement.approach", codes=("unreachable",))
            await stands(cell)
        await asyncio.sleep(1.0)
        control = await accept(cell.client, "placement.approach")
    return Evidence(
        f"refused: {reason_text(verdict)}",
        took_place={"the head is elsewhere by_m": shifted if shifted > 1.0 else 0.0},
        control_kind="without_fault",
        control={"approach when it was back": control.decision},
    )


@fault("B7", how=f"{HOW}: a joint deviates from its command by 0.05 rad")
async def beside(lab: Lab) -> Evidence:
    """The arm is elsewhere than commanded."""
    joint = lab.random.choice((2, 3, 4))
    end = {"joint": joint, "angle": 0.0}
    return await braked(lab, "offset_joint", {"joint": joint, "angle": 0.05}, end)


@fault("B8", how=f"{HOW}: the operating mode changes")
async def mode(lab: Lab) -> Evidence:
    """The mode switch is turned in motion."""
    return await braked(lab, "change_mode")


@fault("B8", how=f"{HOW}: the brakes close")
async def brakes(lab: Lab) -> Evidence:
    """The brakes close in motion."""
    return await braked(lab, "close_brakes")


@fault("B9", how="simulated arm: moved by hand while it was disconnected")
async def guided(lab: Lab) -> Evidence:
    """The arm is elsewhere when it is connected again."""
    angle = lab.random.choice((-1.0, 1.0)) * lab.random.uniform(0.2, 0.4)
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_standoff(cell.client)
        before = await _joints(cell)
        async with injected(cell, "drop_client", {}, {}):
            pass
        await until(
            cell.client, lambda shown: (shown.branches["robot"], shown.branches["placement"]) == ("0", "unknown")
        )
        async with injected(cell, "guide_by_hand", {"joint": 1, "angle": angle}, {}):
            pass
        await asyncio.sleep(2.0)
        await connect(cell.client)
        located = await until(cell.client, lambda shown: shown.branches["placement"] != "unknown")
        found = located.branches["placement"]
        expect(found in ("held", "retracted"), f"The arm was moved, and counts as {found}.")
        moved = float(np.abs(np.subtract(await _joints(cell), before)).max())
        expect(moved > 0.1, f"The arm was not moved by hand: {moved:.3f} rad.")
        await refused(cell, "placement.approach", codes=("latched", "invalid_in_state"))
        await confirmed(cell)
        await accept(cell.client, "placement.home")
        control = await accept(cell.client, "placement.approach")
    return Evidence(
        f"placement unknown, then {found}",
        took_place={"moved_rad": moved},
        control_kind="without_fault",
        control={"approach once it was confirmed": control.decision},
    )


async def _joints(cell: RunningCell) -> list[float]:
    joints = await cell.client.request_device("robot", "joints")
    return list(joints["positions"])


@fault("B10", how="simulated arm refuses: the step of robot.connect raises")
async def raising(lab: Lab) -> Evidence:
    """A step raises an error, and the state stays."""
    async with lab.cell(*REAL_TIME) as cell:
        async with injected(cell, "refuse_robot"):
            verdict = await cell.client.call("robot.connect")
            _expect_end(verdict, ("failed", "0"))
            expect((await cell.client.state()).branches["robot"] == "0", "The robot counts as connected.")
        await connect(cell.client)
        reached = await state(cell.client, "robot")
    return Evidence(
        f"failed, state 0 kept: {reason_text(verdict)}",
        took_place={"the robot's own reason": reason_text(verdict)},
        control_kind="without_fault",
        control={"connected when it did not refuse": reached == "1"},
    )


@fault("B11", how=f"{HOW}: the cabinet's application fails and closes the connection")
async def dropped(lab: Lab) -> Evidence:
    """The application on the cabinet fails in motion."""
    return await lost(lab, "drop_client", {}, {}, REPORTED)


@asynccontextmanager
async def _reconnect_far_away(cell: RunningCell, counts: DroppedSetpoints) -> AsyncIterator[tuple[JointSetpoint, int]]:
    """Have the arm follow set points, move it far from the last of them, and disconnect and connect it.

    Yields:
        Last set point of the earlier connection, and the number of dropped ones before it was lost.
    """
    received: list[JointSetpoint] = []
    end = cell.client.listen("dev/robot/setpoint", JointSetpoint, received.append)
    await to_following(cell.client)
    await accept(cell.client, "placement.stop_following")
    await end()
    expect(bool(received), "The tool followed, but no set point was received.")
    await to_retracted(cell.client)
    away = float(np.abs(np.subtract(await _joints(cell), received[-1].positions)).max())
    expect(away > 0.1, f"The arm is only {away:.3f} rad from the last set point, too close to show whether it follows.")
    dropped = await counts.current()
    await cell.scene.inject("drop_client", {})
    await until(cell.client, lambda shown: shown.branches["robot"] == "0")
    before = await tool_position(cell)
    await connect(cell.client)
    yield received[-1], dropped
    await stands(cell)
    moved = math.dist(before, await tool_position(cell))
    expect(moved < 1e-3, f"The tool moved by {moved * 1e3:.1f} mm after the reconnection.")
    expect((await cell.client.state()).latched, "The latch was released although nobody confirmed.")
    await confirmed(cell)


@fault("B12", how="simulated arm: the last set point of the earlier connection arrives with the new one")
async def late(lab: Lab) -> Evidence:
    """A set point of the earlier connection arrives after a new connection."""
    async with (
        lab.cell(*REAL_TIME, fresh=False) as cell,
        dropped_setpoints(cell, "stale_setpoints") as counts,
        injected(cell, "late_set_point"),
        _reconnect_far_away(cell, counts) as (setpoint, before),
    ):
        dropped = await counts.increase_since(before)
    return Evidence(
        "dropped and counted: the arm stands after the reconnection",
        took_place={"set points that the robot counts as late": dropped},
        control_kind="without_fault",
        control={"set points followed in the connection that they were for": setpoint.number},
        details={"session": setpoint.session},
    )


@fault("B12", how="the last set point of the earlier connection is put on the bus again after the new one")
async def late_on_the_bus(lab: Lab) -> Evidence:
    """The node drops it, and counts that."""
    async with (
        lab.cell(*REAL_TIME, fresh=False) as cell,
        dropped_setpoints(cell, "setpoints") as counts,
        _reconnect_far_away(cell, counts) as (setpoint, before),
    ):
        inject_unless_sham(lambda: cell.bus.publish("dev/robot/setpoint", setpoint))
        dropped = await counts.increase_since(before)
        expect(dropped == 1, f"One set point came late, and {dropped} were counted.")
    return Evidence(
        "dropped and counted: the arm stands after the reconnection",
        took_place={"set points that the node counts as late": dropped},
        control_kind="without_fault",
        control={"set points followed in the connection that they were for": setpoint.number},
    )


@fault("B12", how="a command sent an hour ago reaches the daemon over the bus now")
async def old_command(lab: Lab) -> Evidence:
    """A command that was delayed on its way is not executed late."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        age = 0.0 if is_sham() else lab.random.uniform(10.0, 3600.0)
        sent = SystemClock().wall() - age
        before, row, key = await cell.client.state(), cell.last_row(), command_key("local", "placement", "approach")
        verdict = await cell.bus.request(key, Envelope(id=f"old-{sent}", sent=sent, ttl=5.0), Verdict, 20.0)
        await check_refused(cell, verdict, before, row, ("expired",))
        await stands(cell)
        fresh = Envelope(id=f"new-{sent}", sent=SystemClock().wall(), ttl=5.0)
        control = await cell.bus.request(key, fresh, Verdict, 20.0)
        expect(control.decision == "accepted", f"Sent again it was {control.decision}: {reason_text(control)}.")
    return Evidence(
        f"refused: {reason_text(verdict)}",
        took_place={"age at the daemon, s": verdict.reason.fields["age"] if verdict.reason is not None else 0.0},
        control_kind="without_fault",
        control={"the same command, sent now": control.decision},
    )


@fault("B13", how="simulated arm: every set point arrives twice while the tool follows")
async def doubled(lab: Lab) -> Evidence:
    """The arm follows every set point once."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell, dropped_setpoints(cell, "stale_setpoints") as counts:
        await to_following(cell.client)
        once = await _setpoints(cell)
        before = await counts.current()
        async with injected(cell, "double_commands"):
            sent = await _setpoints(cell)
            shown = (await cell.client.state()).branches
            repeated = await counts.current() - before
        if shown["placement"] != "following":
            await wait_until_stationary(cell.client)
            await to_following(cell.client)  # not run if it does not follow without the fault either
            raise Unmet(f"With every set point twice it does not follow: {shown}.")
        await accept(cell.client, "placement.stop_following")
    expect(repeated > sent / 2, f"{sent} set points were sent, and the robot has dropped {repeated} as repeated.")
    return Evidence(
        "followed on, every set point once",
        took_place={"repeated set points that the robot has dropped": repeated},
        control_kind="without_fault",
        control={"set points followed that came once": once},
        details={"sent": sent, "seconds": FOLLOWED},
    )


async def _setpoints(cell: RunningCell) -> int:
    """Return the number of set points that a following tool is sent during `FOLLOWED`."""
    received: list[JointSetpoint] = []
    end = cell.client.listen("dev/robot/setpoint", JointSetpoint, received.append)
    await asyncio.sleep(FOLLOWED)
    await end()
    return len(received)


@fault("B13", how="a motion is requested twice with one id, the second time while the first moves")
async def twice(lab: Lab) -> Evidence:
    """One command id causes one motion."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        row, name = cell.last_row(), f"twice-{lab.random.random()}"
        async with moving(cell.client, id=name) as first:
            same = f"{name}-b" if is_sham() else name
            again = asyncio.create_task(cell.client.call("placement.approach", id=same))
            await cell.client.state()  # a round trip, after which the earlier command has reached the daemon
            expect(not first.done(), "The motion had ended before it was requested again.")
            second = await again
        expect(first.result() == second and second.decision == "accepted", f"{first.result()} and {second}")
        begun = [stored for stored in cell.rows(row) if (stored.kind, stored.command_id) == ("intent", name)]
        expect(len(begun) == 1, f"It began {len(begun)} times.")
        await to_retracted(cell.client)
        other = await accept(cell.client, "placement.approach")
    return Evidence(
        "moved once, one verdict for both",
        took_place={"verdicts received for one id": [first.result().sequence, second.sequence]},
        control_kind="without_fault",
        control={"approach with another id": other.decision, "rows later": other.sequence - second.sequence},
        details={"begun": len(begun)},
    )


@fault("B14", how=f"{HOW}: an object pushes against the tool with 35 N or more")
async def collision(lab: Lab) -> Evidence:
    """An object pushes against the tool."""
    return await braked(lab, "push_tool", {"force": lab.random.uniform(35.0, 50.0)}, {"force": 0.0})


PLAIN = (*VIRTUAL, "sim.arm.physics=kinematic")
SEGMENT_WAY = 0.006
"""Longest way of the tool after a Stop if the arm moves in segments, m: one segment, and what is measured beside it."""


@fault(
    "B15",
    how="virtual cabinet without the servo option: first a stream, then motions in segments, one of them stopped",
    deadline=400.0,
)
async def without_servo(lab: Lab) -> Evidence:
    """The controller cannot follow set points, and does not stop a motion that it has started."""
    async with lab.daemon(*PLAIN) as cell:
        await to_retracted(cell.client)
        async with injected(cell, "withdraw_servo"):
            stream = await cell.client.call("placement.approach")
            expect(stream.decision == "failed", f"With a stream the approach was {stream.decision}.")
        await confirmed(cell)
        if not await _retracted(cell):
            await accept(cell.client, "placement.home")
        control = await accept(cell.client, "placement.approach")
    async with lab.daemon(*PLAIN, "kst.motion=ptp") as cell, injected(cell, "withdraw_servo"):
        await to_placed(cell.client)
        for operation in ("press", "follow"):
            await refused(cell, f"placement.{operation}", codes=("point_to_point",))
        await accept(cell.client, "placement.back_off")
        async with moving(cell.client, "placement.home"):
            before = await tool_position(cell)
            await cell.client.stop()
        await held(cell)
        way = math.dist(before, await tool_position(cell))
        expect(way <= SEGMENT_WAY, f"After the Stop the tool went {way * 1e3:.1f} mm, more than a segment.")
        await confirmed(cell)
    return Evidence(
        "held at the end of a segment; what needs a stream is refused",
        took_place={"the cabinet's answer to a stream": reason_text(stream)},
        control_kind="without_fault",
        control={"approach with the option": control.decision},
        details={"way after the Stop, mm": way * 1e3},
    )
