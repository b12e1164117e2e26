"""Floods of the bus by a user who may only watch, or whose commands are rejected: Stop is in time."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

from pcmrs.dispatcher.decisions import BURST, DROPPED, TOO_MANY
from pcmrs.dispatcher.events import FAIL_STOP, PRESSED_AGAIN
from pcmrs.errors import PayloadError, PcmrsError
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.journal.reader import journal_files
from pcmrs.messages import JournalQuery
from pcmrs.messages.clipping import CLIPPED
from pcmrs.planner import Planner
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import (
    accept,
    approach_alone,
    moving,
    register,
    reset_cell,
    to_placed,
    to_standoff,
    tool_pose,
    until,
)
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.bus_flood import ARGUMENT_SIZE, FLOODER, Kind, bus_flood
from pcmrs_lab.campaign.checks import confirmed, expect, held, reported
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.faults.adversary import in_ms, stop_times
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.lateness import timer_lateness
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.stop_limits import exceeded
from pcmrs_lab.campaign.tries import (
    COMMANDS,
    DEVICES,
    FLOODING,
    LOCAL_ACCOUNT,
    QUERIES,
    SETPOINTS,
    STOP,
    STREAMS,
    record,
)
from pcmrs_lab.campaign.without_guard import without_guards

STOPS = 100
MALFORMED = PayloadError.code
PRESSES = 20_000
REJECTED = 4 * BURST
FLOODERS: dict[Kind, str] = {"rejected": FLOODER, "rejected-names": "mallory", "rejected-keys": "trudy"}
"""User who sends each flood of rejected commands: each has its own number of rejections that get a row."""
LIMIT = 3.0
"""Time without attendance after which a session is made safe here, s of the machine."""
ABANDONED_AFTER_LIMIT = (f"procedure.abandoned_after={LIMIT:g}", "workflow=ratms_threshold", *REAL_TIME)
OVER = 1.0
"""Time without messages after which a flood is over, s of the machine."""
REPORTED_WITHIN = 30.0
"""Time within which the number of rejections without a row is journalled, s of the machine."""


@fault("A21", how="puts on stop/eve, as fast as a process can", deadline=180.0, tries={FLOODING: [STOP]})
async def stop_by_a_viewer(lab: Lab) -> Evidence:
    """A motion is stopped by the first press; Stops of others are in time, and the cell can be used again."""
    async with lab.daemon("cell.rate=1", "procedure.max_pose_age=0.5", "robot.deadman=0.5") as cell:
        await register(cell.client)
        row = cell.last_row()
        async with (
            moving(cell.client),
            bus_flood("stop-puts", cell.ready.endpoint, cell.name, most=PRESSES) as flooding,
        ):
            await held(cell)
        stopped = (await cell.client.state()).latched
        await confirmed(cell)
        counted = await _presses(cell, row)
        details = {"sent": flooding.report.sent, "rate_hz": round(flooding.report.rate), **counted}
        expect(flooding.report.sent == PRESSES, f"Only {flooding.report.sent} presses were sent.")
        expect(0 < counted["presses"] < PRESSES, f"Of {PRESSES} presses of one link {counted['presses']} came through.")
        expect(counted["rows"] < PRESSES / 10, f"{PRESSES} presses have {counted['rows']} rows.")
        details |= await _stops_in_time(cell, "stop-puts")
        await _until_over(cell, row)
        expect(not any(entry.operation == FAIL_STOP for entry in cell.rows(row)), "The dispatcher has failed.")
        await confirmed(cell)
        await reset_cell(cell.client)
        alone = await approach_alone(cell.client)
    return Evidence(
        "one Stop at a time, counted, and others are in time",
        took_place={"presses_in_the_journal": counted["presses"]},
        control_kind="permitted",
        control={"stopped_by_the_first_press": stopped, "approach_without_stop": alone.decision},
        details=details,
    )


@fault(
    "A22",
    how="commands that are rejected, with 60 kB in an argument, in its name, and in the key",
    deadline=240.0,
    tries={FLOODING: [COMMANDS]},
)
async def rejected_without_end(lab: Lab) -> Evidence:
    """A permitted user sends rejected commands without end; then the same user sends an accepted one."""
    async with lab.daemon("cell.rate=1") as cell:
        await register(cell.client)
        row, details, took_place = cell.last_row(), dict[str, Any](), dict[str, int]()
        for kind, user in FLOODERS.items():
            before = _size(cell)
            async with bus_flood(kind, cell.ready.endpoint, cell.name, user=user, most=REJECTED) as flooding:
                pass
            codes = flooding.report.codes or {}
            if kind == "rejected-keys":
                took_place[kind] = await reported(cell, row, edge="bus", code=MALFORMED, count=REJECTED)
            else:
                expect(codes.get(TOO_MANY, 0) > 0, f"No answer to {kind} reports the limit: {codes}.")
                rows, dropped = await _on_record(cell, row, user, sum(codes.values()))
                took_place |= {f"{kind}: rows": rows, f"{kind}: counted without row": dropped}
            grown = _size(cell) - before
            expect(grown < REJECTED * ARGUMENT_SIZE / 10, f"By {kind} the journal has grown by {grown} bytes.")
            details[kind] = {"codes": codes, "grown": grown}
        page = await cell.client.journal(JournalQuery(after=row, limit=200))
        expect(len(page.rows) > 0, "The journal cannot be read over the bus.")
        planned = await accept(cell.client, "toolplan.plan", **tool_pose())
        await accept(cell.client, "toolplan.reinit")
        await reset_cell(cell.client)
    unlimited = without_guards("every_rejection_has_a_row", "long_arguments_are_kept")
    async with lab.daemon("cell.rate=1", prefix=unlimited) as other:
        before = _size(other)
        async with bus_flood("rejected", other.ready.endpoint, other.name, most=REJECTED):
            pass
        unbounded = _size(other) - before
        expect(unbounded > REJECTED * ARGUMENT_SIZE / 2, f"Without the guards the journal grew by {unbounded} bytes.")
    return Evidence(
        "bounded, and counted",
        took_place=took_place,
        control_kind="mutant",
        control={"bytes_of_the_journal_without_the_guards": unbounded},
        details=details | {"the_same_operation_with_a_pose": planned.decision},
    )


@fault(
    "A23",
    how="100 requests at a time on svc/setup, then on svc/journal, then on svc/check",
    deadline=240.0,
    tries={FLOODING: [QUERIES]},
)
async def queries_without_end(lab: Lab) -> Evidence:
    """Queries of other users are answered meanwhile, and Stop is in time."""
    async with lab.daemon("cell.rate=1", "procedure.max_pose_age=0.5", "robot.deadman=0.5") as cell:
        await register(cell.client)
        row, before = cell.last_row(), await _refused_requests(cell)
        alone = await cell.client.journal(JournalQuery(limit=1))
        details = await _stops_in_time(cell, "setup")
        details |= await _stops_in_time(cell, "journal")
        details |= await _stops_in_time(cell, "check")
        answered = {kind: details[f"{kind}_answers"] for kind in ("setup", "journal", "check")}
        refused = await _refused_requests(cell) - before
        expect(not any(entry.operation == FAIL_STOP for entry in cell.rows(row)), "The dispatcher has failed.")
        await confirmed(cell)
        await reset_cell(cell.client)
    return Evidence(
        "a few at a time, and Stop is in time",
        took_place={"requests_without_a_place": refused},
        control_kind="permitted",
        control={"answered_in_their_turn": answered, "rows_answered_to_one_request": len(alone.rows)},
        details=details,
    )


@fault(
    "A23",
    how="puts without a seal on keys of devices and streams, and set points of somebody who guides nothing",
    deadline=240.0,
    tries={FLOODING: [SETPOINTS, DEVICES, STREAMS]},
)
async def puts_without_end(lab: Lab) -> Evidence:
    """None of them counts, the robot is not lost, and Stop is in time."""
    async with lab.daemon("cell.rate=1", "procedure.max_pose_age=0.5", "robot.deadman=0.5") as cell:
        await register(cell.client)
        row, before = cell.last_row(), await _unsealed(cell)
        details = await _stops_in_time(cell, "setpoints")
        details |= await _stops_in_time(cell, "devices")
        details |= await _stops_in_time(cell, "streams")
        unsealed = await _unsealed(cell) - before
        expect(not any(entry.operation == FAIL_STOP for entry in cell.rows(row)), "The dispatcher has failed.")
        expect((await cell.client.state()).branches["robot"] == "1", "The robot was lost.")
        await confirmed(cell)
        await reset_cell(cell.client)
        alone = await approach_alone(cell.client)
    return Evidence(
        "dropped and counted, and Stop is in time",
        took_place={"puts_without_a_seal": unsealed},
        control_kind="permitted",
        control={"approach_with_sealed_streams": alone.decision},
        details=details,
    )


@fault(
    "A24", how="an operation that is rejected twice a second; the limit is 3 s here", tries={LOCAL_ACCOUNT: [COMMANDS]}
)
async def asked_in_vain(lab: Lab) -> Evidence:
    """The stimulator is armed, the tool on the head: a program whose commands are rejected does not attend."""
    async with lab.daemon(*ABANDONED_AFTER_LIMIT) as cell:
        await _arm_at_the_head(cell)
        attended = []
        for _ in range(10):
            await asyncio.sleep(0.5)
            attended.append(await accept(cell.client, "stimulation.set_intensity", percent=50.0))
        row = cell.last_row()
        expect(not (await cell.client.state()).latched, "The cell was held although it was attended.")
        requesting = asyncio.create_task(_request_rejected(cell))
        try:
            await until(cell.client, lambda shown: shown.latched and shown.branches["stimulation"] == "disarmed")
        finally:
            requesting.cancel()
            rejections = await requesting
        expect(rejections > 0, "No command was sent.")
        decided = [
            each.verdict.decision for each in cell.rows(row) if each.operation == "set_intensity" and each.verdict
        ]
        await confirmed(cell)
    async with lab.daemon(*ABANDONED_AFTER_LIMIT, prefix=without_guards("rejected_commands_attend")) as other:
        await _arm_at_the_head(other)
        requesting = asyncio.create_task(_request_rejected(other))
        await asyncio.sleep(2 * LIMIT)
        shown = await other.client.state()
        requesting.cancel()
        attending = await requesting
        expect(not shown.latched, "Without the guard, too, the cell was held.")
    return Evidence(
        "held, latched, disarmed",
        took_place={"rejected_in_the_journal": decided.count("rejected")},
        control_kind="mutant",
        control={
            "rejected_ones_that_attend_without_the_guard": attending,
            "not_held_during_5_s_of_accepted_ones": sum(each.decision == "accepted" for each in attended),
        },
        details={"rejected": rejections},
    )


async def _arm_at_the_head(cell: RunningCell) -> None:
    await to_placed(cell.client)
    await accept(cell.client, "stimulation.set_ceiling", percent=80.0, operator="simulated operator")
    await accept(cell.client, "stimulation.set_intensity", percent=50.0)
    await accept(cell.client, "stimulation.arm")


@fault(
    "A24",
    how="a signed peer with the role of a planner, whose command is accepted twice a second; the limit is 3 s here",
    tries={"peer": ["UDP"]},
)
async def planner_is_no_attendance(lab: Lab) -> Evidence:
    """The tool is at the head: accepted commands of somebody who may not hold the lease are no attendance."""
    key = lab.folder / "peer.key"
    new_key(key)
    settings = ("procedure.abandoned_after=3", f"gateway.peers.panel.key_file={key}", *REAL_TIME)
    async with lab.daemon(*settings) as cell:
        await to_standoff(cell.client)
        attended = []
        for _ in range(10):
            await asyncio.sleep(0.5)
            attended.append(await accept(cell.client, "digitization.clear_surface"))
        row = cell.last_row()
        expect(not (await cell.client.state()).latched, "The cell was held although it was attended.")
        link = await Planner.open(*cell.ready.links["planner"], signer=Signer("panel", read_key(key)))
        async with link as planner:
            requesting = asyncio.create_task(_request_accepted(planner))
            try:
                await until(cell.client, lambda shown: shown.latched)
            finally:
                requesting.cancel()
                accepted = await requesting
        verdicts = [each.verdict for each in cell.rows(row) if each.source == "peer:panel" and each.verdict]
        decided = [verdict.decision for verdict in verdicts]
        await confirmed(cell)
    return Evidence(
        "held and latched",
        took_place={"accepted_in_the_journal": decided.count("accepted")},
        control_kind="permitted",
        control={"not_held_during_5_s_of_an_operators": sum(each.decision == "accepted" for each in attended)},
        details={"accepted": accepted},
    )


async def _request_accepted(planner: Planner) -> int:
    """Send commands of a planner that are accepted until cancelled, and return how many; none in a sham campaign."""
    accepted = 0
    try:
        if is_sham():
            await asyncio.Event().wait()
        while True:
            verdict = await planner.command("icp_clear_allxxx")
            record("peer", "UDP")
            expect(verdict.decision == "accepted", f"It was {verdict.decision}.")
            accepted += 1
            await asyncio.sleep(0.5)
    except asyncio.CancelledError:
        return accepted


async def _request_rejected(cell: RunningCell) -> int:
    """Send rejected commands until cancelled, and return how many. In a sham campaign none is sent."""
    rejections = 0
    try:
        if is_sham():
            await asyncio.Event().wait()
        while True:
            verdict = await cell.client.call("stimulation.set_intensity", {"percent": 500.0})
            record(LOCAL_ACCOUNT, COMMANDS)
            expect(verdict.decision == "rejected", f"It was {verdict.decision}.")
            rejections += 1
            await asyncio.sleep(0.5)
    except asyncio.CancelledError:
        return rejections


async def _stops_in_time(cell: RunningCell, kind: Kind) -> dict[str, Any]:
    """Check Stops of another user during a flood against a bare timer, and return the measured values."""
    async with bus_flood(kind, cell.ready.endpoint, cell.name) as flooding, timer_lateness() as timer:
        try:
            taken = await stop_times(cell, STOPS)
            await cell.client.state()
        except PcmrsError as error:
            raise Unmet(f"During {kind} another user was not answered: {error}") from None
    report = flooding.report
    expect(report.sent > STOPS, f"Of {kind} only {report.sent} were sent.")
    details: dict[str, Any] = {f"{kind}_hz": round(report.rate), f"{kind}_answers": report.codes or {}}
    details |= in_ms(f"stop_{kind}", taken) | in_ms(f"timer_{kind}", timer.late)
    late = " ".join(exceeded(taken, timer.late))
    expect(not late, f"Stop during {kind} was late: {late} {details}")
    return details


async def _refused_requests(cell: RunningCell) -> int:
    """Return how many requests on the bus the daemon has refused for lack of a place."""
    return sum(queue.refused or 0 for queue in (await cell.client.health()).queues if queue.queue == "bus")


async def _unsealed(cell: RunningCell) -> int:
    """Return how many messages without a seal the daemon has dropped."""
    return (await cell.client.health()).dropped["bus.not_sealed"]


async def _until_over(cell: RunningCell, row: int) -> None:
    """Wait until no more presses of the flooder come: some are in transit when its process has ended."""
    before: dict[str, int] = {}
    while (presses := await _presses(cell, row)) != before:
        before = presses
        await asyncio.sleep(OVER)


async def _presses(cell: RunningCell, row: int) -> dict[str, int]:
    """Return how many presses by the flooder the journal counts, and in how many rows."""
    source = f"bus:{FLOODER}"
    rows = [each for each in cell.rows(row) if each.source == source]
    stops = sum(each.operation == "stopped" for each in rows)
    joined = [each.result["fields"] for each in rows if each.operation == PRESSED_AGAIN and each.result is not None]
    return {"presses": stops + sum(each["presses"] for each in joined), "rows": len(rows)}


async def _on_record(cell: RunningCell, row: int, user: str, rejected: int) -> tuple[int, int]:
    """Return how many rejections of a user have a row, one of them clipped, and how many are only counted."""
    started = time.monotonic()
    while True:
        found = cell.rows(row)
        rows = [each for each in found if each.kind == "outcome" and each.source == f"bus:{user}"]
        reports = [each.result["fields"] for each in found if each.operation == DROPPED and each.result is not None]
        dropped = sum(each["count"] for each in reports if each["user"] == user)
        if len(rows) + dropped == rejected:
            expect(any(CLIPPED in (each.arguments or {}) for each in rows), "No argument was clipped.")
            return len(rows), dropped
        if time.monotonic() - started > REPORTED_WITHIN:
            raise Unmet(f"{rejected} were rejected: {len(rows)} rows, and {dropped} are counted.")
        await asyncio.sleep(0.5)


def _size(cell: RunningCell) -> int:
    """Return the size of the journal with its logs, bytes."""
    first = Path(cell.ready.journal)
    parts = [Path(f"{file}{suffix}") for file in journal_files(first) for suffix in ("", "-wal")]
    return sum(part.stat().st_size for part in parts if part.exists())
