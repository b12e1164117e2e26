"""Faults of order: Stop, an event, a command or a crash comes while a disk, a link or a loop is slow."""

from __future__ import annotations

import asyncio
import math
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import ActToken, DeviceReply, DeviceRequest, NodeBeat, Snapshot
from pcmrs.testing.arm import BRAKING, standing, stands, tool_position
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import (
    PATIENCE,
    accept,
    connect,
    digitize_landmarks,
    moving,
    reason_text,
    reset_cell,
    state,
    to_placed,
    to_retracted,
    to_standoff,
    tool_pose,
    until,
)
from pcmrs.testing.errors import Unmet
from pcmrs.threads import descendants
from pcmrs_lab.campaign.checks import confirmed, expect, held, refused
from pcmrs_lab.campaign.datagrams import Raw, raw_socket
from pcmrs_lab.campaign.delays import Rule, delays_of
from pcmrs_lab.campaign.driving import injected
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.faults.order_requests import ROBOT, delayed
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.samples import process_state
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.waiting import until_logged, until_true

SLOW = 0.5
"""Delay of the slow component, s of the machine: less than the limit within which a hold is confirmed."""

DISK = "the journal's thread waits before a commit, as for a slow disk"
COMMIT = "journal.before_commit"
OFTEN = 1000


@asynccontextmanager
async def writing(cell: RunningCell, what: str, *, ended: bool = True) -> AsyncIterator[Rule]:
    """Slow the disk down, and begin the context when a motion's row of a kind is about to be written.

    Args:
        cell: Cell with the disk.
        what: ``intent`` or ``outcome``.
        ended: False if the daemon does not survive the context.

    Yields:
        Rule of the slow disk.
    """
    here, slow = Rule("pass", f"dispatcher.before_{what}"), Rule("pass", COMMIT, seconds=SLOW, times=OFTEN)
    async with delays_of(cell).delaying(here, slow, ended=ended):
        await delays_of(cell).wait_until_delaying(here)
        await delays_of(cell).wait_until_delaying(slow)
        yield slow


def _stopped(number: int) -> Callable[[Snapshot], bool]:
    return lambda shown: shown.latched and shown.stop.number > number


@fault("Q3", how="a motion's request as an earlier daemon, or one to an earlier node, would have made it")
async def earlier_session(lab: Lab) -> Evidence:
    """A request of another session has no effect at any age and number; one of the present session has."""
    beats: list[NodeBeat] = []
    async with lab.daemon(*REAL_TIME) as cell:  # its own numbers do not count after this
        await to_standoff(cell.client)
        await asyncio.sleep(BRAKING)
        end = cell.bus.subscribe("dev/robot/beat", NodeBeat, lambda _, beat: beats.append(beat))
        await until_true(lambda: bool(beats) and beats[-1].gate is not None, "The robot's node sends no heartbeat")
        await end()
        gate = beats[-1].gate
        if gate is None:
            raise Unmet("The node does not report its gate.")
        present = ActToken(daemon=gate.daemon, node=gate.node, epoch=gate.epoch, number=1_000_000)
        others = {"daemon": "earlier", "node": "earlier", "epoch": gate.epoch - 1}
        arm = await cell.client.request_device("robot", "joints")
        trajectory = {"trajectory": {"period": 0.02, "positions": [arm["positions"]] * 3}}
        codes = []
        async with standing(cell) as moved:
            for field, value in others.items() if not is_sham() else ():
                codes.append(await _refusal(cell, msgspec.structs.replace(present, **{field: value}), trajectory))
        expect(codes == ["stale_request"] * 3, f"Requests of another {', '.join(others)} were answered: {codes}.")
        control = await _reply(cell, present, trajectory)
        outcome = (control.result or {}).get("outcome", "")
        expect(outcome == "done", f"A request of the present sessions ended as {control}.")
        await cell.client.stop()
        await held(cell, ("standoff",))
        await confirmed(cell)
    return Evidence(
        "stale_request",
        took_place={"answered_by_the_node": codes},
        control_kind="without_fault",
        control={"of_the_present_sessions": outcome},
        details={"moved_rad": moved[0]},
    )


async def _reply(cell: RunningCell, token: ActToken, trajectory: dict[str, Any]) -> DeviceReply:
    request = DeviceRequest(method="follow", arguments=trajectory, token=token)
    return await cell.bus.request(ROBOT, request, DeviceReply, PATIENCE)


async def _refusal(cell: RunningCell, token: ActToken, trajectory: dict[str, Any]) -> str | None:
    reply = await _reply(cell, token, trajectory)
    return None if reply.failure is None else str(reply.failure.fields.get("code", reply.failure.code))


@fault("Q4", how="two Stops; then the acknowledgement of the first")
async def old_acknowledgement(lab: Lab) -> Evidence:
    """An acknowledgement that was late on the network does not release a newer Stop."""
    rule = Rule("receive", ROBOT, "hold", SLOW)
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_standoff(cell.client)
        await asyncio.sleep(BRAKING)
        await cell.client.stop()
        first = (await until(cell.client, lambda shown: shown.latched and not shown.stop.pending)).stop.number
        async with delays_of(cell).delaying(rule):
            await cell.client.stop()
            newest = (await until(cell.client, _stopped(first))).stop.number
            verdict = await cell.client.call("robot.acknowledge", {"stop": first})
            late = await delays_of(cell).wait_until_delayed(rule)
        await until(cell.client, lambda shown: not shown.stop.pending)
        again = await refused(cell, "robot.acknowledge", {"stop": first}, codes=("stop_outdated",))
        expect(verdict.decision == "rejected", f"The acknowledgement of Stop {first} was {verdict.decision}.")
        await refused(cell, "placement.home", codes=("latched",))
        control = await accept(cell.client, "robot.acknowledge", stop=newest)
        await accept(cell.client, "placement.back_off")
    return delayed(f"refused: {reason_text(again)}", late, newest_acknowledged=control.decision)


@fault("Q5", how="the bus delivers the hold late; the reference slips in that moment")
async def event_while_the_hold_is_slow(lab: Lab) -> Evidence:
    """The event revokes the registration at once; acknowledgement and confirm are refused before it is decided."""
    rule = Rule("receive", ROBOT, "hold", SLOW)
    async with lab.cell(*REAL_TIME, delayed=True) as cell:
        await to_standoff(cell.client)
        await asyncio.sleep(BRAKING)
        async with delays_of(cell).delaying(rule), standing(cell) as moved:
            await slipped(cell)
            await delays_of(cell).wait_until_delaying(rule)
            acknowledged, confirm = await asyncio.gather(
                cell.client.call("robot.acknowledge"), cell.client.call("placement.confirm", timeout=PATIENCE)
            )
            shown = await until(cell.client, lambda shown: shown.branches["registration"] != "111")
            late = await delays_of(cell).wait_until_delayed(rule)
        expect(confirm.decision == "rejected", f"confirm was {confirm.decision}.")
        expect(acknowledged.decision == "rejected", f"The acknowledgement was {acknowledged.decision}.")
        expect(shown.latched, "Nothing is latched.")
        await confirmed(cell)
        await reset_cell(cell.client)
        await to_standoff(cell.client)
        again = await accept(cell.client, "placement.confirm")
        where = await state(cell.client, "placement")
    response = "registration revoked; acknowledgement and confirm refused"
    return delayed(response, late, moved, registered_again=again.decision, reached=where)


async def slipped(cell: RunningCell) -> None:
    """Make the reference slip on the head."""
    if not is_sham():
        await cell.scene.inject("bump_reference", {"millimetres": 8.0})


async def beside_a_retreat(lab: Lab, name: str, arguments: dict[str, Any], *, plan: bool) -> Evidence:
    """Send a command that revokes the plan of a standoff while the retreat to it is being committed.

    Args:
        lab: Surroundings of the fault.
        name: Command, ``branch.operation``.
        arguments: Arguments of the command.
        plan: True if the command leaves a plan.

    Returns:
        Evidence of the row.
    """
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_placed(cell.client)
        before = await cell.client.state()
        async with moving(cell.client, "placement.back_off") as retreat, writing(cell, "outcome") as slow:
            verdict = await cell.client.call(name, arguments, timeout=PATIENCE)
            ended = await retreat
            late = await delays_of(cell).wait_until_delayed(slow)
        shown = await until(cell.client, lambda shown: not shown.running)
        where = shown.branches["placement"]
        ready = shown.branches["registration"] == "111" and shown.branches["toolplan"] == "1"
        same = shown.plan == before.plan
        expect(ended.decision == "accepted", f"back_off was {ended.decision}: {reason_text(ended)}.")
        expect(where != "standoff" or (ready and same), f"The tool is at a standoff of another plan: {shown.branches}.")
        expect(verdict.decision == "rejected" or where != "standoff" or plan, f"{name} left {shown.branches}.")
        if where == "held":
            await accept(cell.client, "placement.back_off")
        await to_placed(cell.client)
        again = await accept(cell.client, "placement.back_off")
        reached = await state(cell.client, "placement")
    response = f"{name}: {verdict.decision}, placement {where}"
    return delayed(response, late, alone=again.decision, reached=reached)


@fault("Q6", how=f"{DISK}; the plan is cleared")
async def plan_cleared(lab: Lab) -> Evidence:
    """There is no standoff without a plan."""
    return await beside_a_retreat(lab, "toolplan.clear", {}, plan=False)


@fault("Q6", how=f"{DISK}; the registration is cleared")
async def registration_cleared(lab: Lab) -> Evidence:
    """There is no standoff without a registration."""
    return await beside_a_retreat(lab, "registration.clear_registration", {}, plan=False)


@fault("Q6", how=f"{DISK}; another pose is planned")
async def replanned(lab: Lab) -> Evidence:
    """A standoff never belongs to another plan."""
    return await beside_a_retreat(lab, "toolplan.plan", tool_pose(1), plan=True)


@fault("Q7", how="a planner that sends three motions at once over UDP")
async def queued_motions(lab: Lab) -> Evidence:
    """Motions that are acknowledged during another motion are refused, and not performed after it."""
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_retracted(cell.client)
        row = cell.last_row()
        async with moving(cell.client) as approach:
            names = () if is_sham() else ("execute_confirmx", "execute_homexxxx")
            late = await asyncio.gather(*(cell.planner.command(name, timeout=PATIENCE) for name in names))
            await approach
        async with standing(cell) as moved:
            pass
        rows = cell.rows(row)
        begun = [stored.operation for stored in rows if stored.kind == "intent"]
        asked = [
            stored.operation for stored in rows if stored.verdict is not None and stored.verdict.decision == "rejected"
        ]
        expect(begun == ["approach"], f"These operations have begun: {begun}.")
        expect(all(each.decision == "rejected" for each in late), f"They were {[each.decision for each in late]}.")
        verdict = await cell.planner.command("execute_confirmx", timeout=PATIENCE)
        expect(verdict.decision == "accepted", f"By itself it was {verdict.decision}: {verdict.reason}.")
    return Evidence(
        "refused, and not performed later",
        took_place={"rejected_in_the_journal": asked},
        control_kind="without_fault",
        control={"by_itself": verdict.decision},
        details={"moved_rad": moved[0]},
    )


@fault("Q8", how=f"{DISK}; a planner without ids has requested a result over UDP")
async def late_second_datagram(lab: Lab) -> Evidence:
    """A client that no longer waits for its result would take a late one for the answer to its next command."""
    port = free_port()
    async with (
        lab.daemon(*REAL_TIME, f"gateway.planner.reply_port={port}", delayed=True) as cell,
        raw_socket(cell.ready.links["planner"], port) as raw,
    ):
        await connect(cell.client)
        await digitize_landmarks(cell.client)
        raw.send(b"start_registrati;")
        usual = [await _answer(raw), await _answer(raw)]
        expect(usual[0] == b"ack" and _is_number(usual[1]), f"Without the fault the answers are {usual}.")
        await accept(cell.client, "registration.clear_registration")
        async with delays_of(cell).delaying(rule := Rule("pass", COMMIT, seconds=SLOW, times=OFTEN)):
            raw.send(b"start_registrati;")
            first = await _answer(raw)
            late = await delays_of(cell).wait_until_delayed(rule)
            await until(cell.client, lambda shown: shown.branches["registration"] == "111")
            came = []
            with suppress(TimeoutError):
                async with asyncio.timeout(BRAKING):
                    while True:
                        came.append(await raw.answers.get())
        expect(first == b"ack", f"The first datagram is {first!r}.")
        expect(not any(_is_number(answer) for answer in came), f"A late result was sent: {came}.")
    return delayed("the result is not sent", late, in_time=usual[1].decode())


async def _answer(raw: Raw) -> bytes:
    async with asyncio.timeout(PATIENCE):
        return (await raw.answers.get()).rstrip(b";")


def _is_number(answer: bytes) -> bool:
    return answer.rstrip(b";").replace(b".", b"").isdigit()


PLANNING = b"planning_process"


def _planning_processes(cell: RunningCell) -> list[int]:
    family = descendants(cell.process.pid)
    return [pid for pid in family if PLANNING in Path(f"/proc/{pid}/cmdline").read_bytes()]


@fault("Q9", how="SIGSTOP of the process that plans motions; Stop is pressed meanwhile, and acknowledged")
async def plan_out_of_date(lab: Lab) -> Evidence:
    """A motion whose plan arrives after a Stop does not begin."""
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_retracted(cell.client)
        await asyncio.sleep(BRAKING)
        found = _planning_processes(cell)
        if not found:
            raise NotRun("No process plans motions in this version.")
        row = cell.last_row()
        async with standing(cell) as moved:
            inject_unless_sham(lambda: os.kill(found[0], signal.SIGSTOP))
            asked = asyncio.get_running_loop().time()
            try:
                approach = asyncio.create_task(cell.client.call("placement.approach", timeout=PATIENCE))
                await asyncio.sleep(SLOW)
                answered, frozen = approach.done(), process_state(found[0])
                await cell.client.stop()
                shown = await until(cell.client, lambda shown: shown.latched and not shown.stop.pending)
                await accept(cell.client, "robot.acknowledge", stop=shown.stop.number)
            finally:
                os.kill(found[0], signal.SIGCONT)
            verdict = await approach
            waited = asyncio.get_running_loop().time() - asked
        begun = [stored for stored in cell.rows(row) if (stored.kind, stored.operation) == ("intent", "approach")]
        expect(frozen == "T", f"The process that plans is not stopped: its state is {frozen}.")
        expect(not answered, "The approach did not wait for its plan.")
        expect(verdict.decision != "accepted" and not begun, f"The approach was {verdict.decision}.")
        await to_retracted(cell.client)
        again = await accept(cell.client, "placement.approach")
        where = await state(cell.client, "placement")
    return Evidence(
        f"{verdict.decision}: {reason_text(verdict)}",
        took_place={"state_of_the_process": frozen, "the_approach_waited_s": round(waited, 3)},
        control_kind="without_fault",
        control={"asked_again": again.decision, "reached": where},
        details={"moved_rad": moved[0]},
    )


@fault("Q10", how="simulated arm: a joint of the resting arm is moved by hand while nothing runs")
async def moves_while_nothing_runs(lab: Lab) -> Evidence:
    """It is a danger event: held and latched."""
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_standoff(cell.client)
        await asyncio.sleep(BRAKING)
        before = (await cell.client.state()).stop.number
        resting = await tool_position(cell)
        async with standing(cell) as stood:
            pass
        quiet = await cell.client.state()
        expect(quiet.stop.number == before, "It was stopped while the arm stood.")
        if not is_sham():
            await cell.scene.inject("guide_by_hand", {"joint": 2, "angle": 0.05})
        shown = await until(cell.client, _stopped(before))
        await stands(cell)
        await refused(cell, "placement.confirm", codes=("latched", "not_allowed", "wrong_state"))
        trajectory = math.dist(resting, await tool_position(cell))
        await confirmed(cell)
        await to_standoff(cell.client)
        again = await accept(cell.client, "placement.confirm")
    return Evidence(
        "latched",
        took_place={"moved_by_hand_mm": round(trajectory * 1e3, 2)},
        control_kind="without_fault",
        control={"confirm_of_an_arm_at_rest": again.decision},
        details={"stop": shown.stop.number - before, "stood_within_rad": stood[0]},
    )


async def slow_hold(lab: Lab, rule: Rule) -> Evidence:
    """Check that Stop is pending and cannot be acknowledged until standstill was measured after the hold.

    Args:
        lab: Surroundings of the fault.
        rule: Rule that delays the hold.

    Returns:
        Evidence of the row.
    """
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_retracted(cell.client)
        number = (await cell.client.state()).stop.number
        async with moving(cell.client) as approach, delays_of(cell).delaying(rule):
            await cell.client.stop()
            await delays_of(cell).wait_until_delaying(rule)
            shown = await until(cell.client, _stopped(number))
            verdict = await cell.client.call("robot.acknowledge", {"stop": shown.stop.number})
            late = await delays_of(cell).wait_until_delayed(rule)
            await approach
        expect("standstill" in shown.stop.pending, f"Stop waits for {shown.stop.pending}, not for standstill.")
        expect(verdict.decision == "rejected", f"The acknowledgement was {verdict.decision}.")
        await until(cell.client, lambda shown: not shown.stop.pending)
        await held(cell)
        again = await accept(cell.client, "robot.acknowledge")
        await accept(cell.client, "placement.back_off")
    return delayed(f"refused: {reason_text(verdict)}", late, acknowledged_at_standstill=again.decision)


@fault("Q19", how="the bus delivers the hold late")
async def hold_late(lab: Lab) -> Evidence:
    """The request to hold is late."""
    return await slow_hold(lab, Rule("receive", ROBOT, "hold", SLOW))


@fault("Q20", how="the thread that answers the hold is slow")
async def answer_late(lab: Lab) -> Evidence:
    """The answer to the hold is late."""
    return await slow_hold(lab, Rule("answer", ROBOT, "hold", SLOW))


@fault("Q21", how=DISK)
async def stopped_before_the_intent(lab: Lab) -> Evidence:
    """A motion that is stopped before its intent is durable sends nothing."""
    return await _while_the_intent_is_written(lab, "stop")


@fault("Q23", how=f"{DISK}; the reference slips in that moment")
async def event_before_the_intent(lab: Lab) -> Evidence:
    """A danger event stops like Stop, and has its own effect, too."""
    return await _while_the_intent_is_written(lab, "event")


async def _while_the_intent_is_written(lab: Lab, what: str) -> Evidence:
    async with lab.cell(*REAL_TIME, fresh=what == "event", delayed=True) as cell:
        await to_retracted(cell.client)
        await asyncio.sleep(BRAKING)
        approach = asyncio.create_task(cell.client.call("placement.approach", timeout=PATIENCE))
        async with writing(cell, "intent") as rule, standing(cell) as moved:
            if what == "stop":
                await cell.client.stop()
            else:
                await slipped(cell)
            verdict = await approach
            await until(cell.client, lambda shown: shown.latched)
            late = await delays_of(cell).wait_until_delayed(rule)
        expect(verdict.decision == "failed", f"The approach ended {verdict.decision}: {reason_text(verdict)}.")
        if what == "event":
            await until(cell.client, lambda shown: shown.branches["registration"] != "111")
        await confirmed(cell)
        if what == "event":
            await reset_cell(cell.client)
        await to_retracted(cell.client)
        again = await accept(cell.client, "placement.approach")
        where = await state(cell.client, "placement")
    return delayed("never started", late, moved, asked_again=again.decision, reached=where)


@fault("Q22", how=DISK)
async def stopped_before_the_outcome(lab: Lab) -> Evidence:
    """A motion that has ended when Stop comes keeps its outcome, or counts as held; nothing moves."""
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_standoff(cell.client)
        async with moving(cell.client, "placement.home") as retreat, writing(cell, "outcome") as rule:
            await cell.client.stop()
            verdict = await retreat
            late = await delays_of(cell).wait_until_delayed(rule)
        async with standing(cell) as moved:
            pass
        shown = await until(cell.client, lambda shown: shown.latched and not shown.running)
        where = shown.branches["placement"]
        fits = {"accepted": ("retracted",), "failed": ("held",)}.get(verdict.decision, ())
        expect(where in fits, f"home ended {verdict.decision}, and the tool counts as {where}.")
        await confirmed(cell)
        await to_standoff(cell.client)
        again = await accept(cell.client, "placement.home")
        reached = await state(cell.client, "placement")
    response = f"{verdict.decision}, {where}, latched"
    return delayed(response, late, moved, home_when_acknowledged=again.decision, reached=reached)


@fault("Q24", how=f"{DISK}; SIGKILL of the daemon in that moment", deadline=240.0)
async def killed_before_the_outcome(lab: Lab) -> Evidence:
    """After the restart the motion counts as unknown, and nothing moves before that is resolved."""
    place = lab.folder / "cell"
    async with lab.daemon(*REAL_TIME, folder=place, delayed=True) as first:
        await to_standoff(first.client)
        home = asyncio.create_task(first.client.call("placement.home", timeout=PATIENCE))
        async with writing(first, "outcome", ended=False):
            inject_unless_sham(lambda: first.process.send_signal(signal.SIGKILL))
            status = await first.process.wait()
            home.cancel()
            with suppress(UnknownOutcomeError, asyncio.CancelledError):
                await home
    expect(status == -signal.SIGKILL, f"The daemon ended with status {status}, not by the signal.")
    async with lab.daemon(*REAL_TIME, folder=place, delayed=True) as second:
        shown = await second.client.state()
        expect(shown.latched, "Nothing is latched after the restart.")
        expect(shown.branches["placement"] == "unknown", f"The tool counts as {shown.branches['placement']}.")
        await connect(second.client)
        await refused(second, "placement.home", codes=("latched", "not_allowed", "wrong_state"))
        await accept(second.client, "robot.acknowledge")
        await to_standoff(second.client)
        control = await accept(second.client, "placement.home")
        reached = await state(second.client, "placement")
    return Evidence(
        "latched, unknown",
        took_place={"ended_by": status},
        control_kind="without_fault",
        control={"home": control.decision, "reached": reached},
    )


@fault("Q25", how=DISK)
async def repeated_while_it_is_written(lab: Lab) -> Evidence:
    """A repeat attaches to the command whose outcome is being written."""
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_standoff(cell.client)
        row = cell.last_row()
        name = f"repeated-{lab.seed}-{row}"
        async with moving(cell.client, "placement.home", name) as home, writing(cell, "outcome") as rule:
            second = await cell.client.call("placement.home", id=name, timeout=PATIENCE)
            late = await delays_of(cell).wait_until_delayed(rule)
        first = await home
        begun = [stored for stored in cell.rows(row) if (stored.kind, stored.operation) == ("intent", "home")]
        expect(first == second, f"The first got {first}, the repeat {second}.")
        expect(len(begun) == 1, f"It began {len(begun)} times.")
        other = await cell.client.call("toolplan.plan", tool_pose(1), id=name)
        own = await accept(cell.client, "toolplan.plan", **tool_pose(1))
        expect(other.decision == "rejected", f"Another command of the same id was {other.decision}.")
    return delayed("one outcome", late, same_command_of_another_id=own.decision)


@fault("Q26", how="the daemon's loop stands still, as in a callback that takes long")
async def loop_stands_still(lab: Lab) -> Evidence:
    """Stop reaches the node without the daemon's loop."""
    rule = Rule("pass", "service.before_publish", seconds=SLOW)
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_retracted(cell.client)
        async with moving(cell.client) as approach, delays_of(cell).delaying(rule):
            plan = asyncio.create_task(cell.client.call("toolplan.clear"))
            await delays_of(cell).wait_until_delaying(rule)
            stop = asyncio.create_task(cell.client.stop())
            await asyncio.sleep(SLOW / 2)
            async with standing(cell) as moved:
                late = await delays_of(cell).wait_until_delayed(rule)
            await asyncio.gather(stop, plan)
            verdict = await approach
        expect(verdict.decision == "failed", f"The approach ended {verdict.decision}: {reason_text(verdict)}.")
        await held(cell)
        await confirmed(cell)
        again = await _approached(cell)
    return delayed("held while the loop stood still", late, moved, approach_without_it=again)


@fault("Q27", how="one heartbeat is overtaken by the next ones")
async def beats_out_of_order(lab: Lab) -> Evidence:
    """A beat that is older than the last one does not count, in either direction."""
    rule = Rule("publish", "daemon/beat", seconds=SLOW)
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_retracted(cell.client)
        async with moving(cell.client) as approach, delays_of(cell).delaying(rule):
            late = await delays_of(cell).wait_until_delayed(rule)
            verdict = await approach
        expect(late[0].overtaken > 0, "No beat has overtaken the late one.")
        expect(verdict.decision == "accepted", f"The approach ended {verdict.decision}: {reason_text(verdict)}.")
        where = await state(cell.client, "placement")
    return delayed("the motion continued", late, approach=verdict.decision, reached=where)


@fault("Q28", how="all heartbeats of the daemon are late by more than the deadman")
async def beats_late(lab: Lab) -> Evidence:
    """Late beats count as silence: the time of the loop's last sign of life decides."""
    rule = Rule("publish", "daemon/beat", seconds=3.0, times=100_000)
    async with lab.daemon(*REAL_TIME, "robot.deadman=0.5", delayed=True) as cell:
        await to_retracted(cell.client)
        async with moving(cell.client) as approach:
            async with delays_of(cell).delaying(rule):
                await delays_of(cell).wait_until_delaying(rule)
                await until_logged(cell, "held_by_node")
                late = await delays_of(cell).wait_until_delayed(rule)
            verdict = await approach
        expect(verdict.decision != "accepted", "The approach was accepted.")
        await held(cell, ("held", "unknown"))
        await confirmed(cell)
        again = await _approached(cell)
    return delayed(f"held by the node, {verdict.state}", late, approach_without_it=again)


async def _approached(cell: RunningCell) -> str:
    """Return the decision on an approach without a fault."""
    await to_retracted(cell.client)
    return (await accept(cell.client, "placement.approach")).decision


@fault("Q29", how="the event of an emergency stop is delivered late, after the acknowledgement")
async def event_late(lab: Lab) -> Evidence:
    """A late event is still true as far as the daemon knows: it latches again."""
    rule = Rule("publish", "dev/robot/event", seconds=8 * SLOW)
    async with lab.cell(*REAL_TIME, fresh=False, delayed=True) as cell:
        await to_retracted(cell.client)
        async with delays_of(cell).delaying(rule):
            async with moving(cell.client) as approach, injected(cell, "e_stop"):
                await delays_of(cell).wait_until_delaying(rule)
                verdict = await approach
            await held(cell)
            number = (await cell.client.state()).stop.number
            late = await delays_of(cell).wait_until_delayed(rule)
            shown = await until(cell.client, _stopped(number))
        expect(verdict.decision == "failed", f"The approach ended {verdict.decision}: {reason_text(verdict)}.")
        await confirmed(cell)
        again = await _approached(cell)
    return delayed(f"held, and latched again by {shown.stop.number - number}", late, approach_without_it=again)
