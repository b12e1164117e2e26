"""Operator faults: forbidden requests of a person, over the bus and over UDP, to a running daemon."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
import numpy as np

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.fsm import load_blueprint
from pcmrs.fsm.behaviour import behaviour, joint_of, operations
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Denial
from pcmrs.journal import JournalRow
from pcmrs.testing.arm import stands
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import (
    MOVES,
    accept,
    connect,
    digitize_landmarks,
    landmarks,
    moving,
    plan,
    reason_text,
    register,
    state,
    to_placed,
    to_retracted,
    to_standoff,
    tool_pose,
    until,
)
from pcmrs.testing.errors import Unmet
from pcmrs.workflows import find_workflow
from pcmrs_lab.campaign.checks import check_refused, confirmed, expect, refused, shape
from pcmrs_lab.campaign.every_state import walk
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.without_guard import without_guards
from pcmrs_lab.experiment.tours.arguments import TourArguments, plan_arguments

GATES = ("residual_too_large", "landmark_outlier", "swapped_landmarks", "mirrored", "tre_too_large")
"""Codes of a registration that is refused because of its landmarks."""


@fault(
    "O1",
    how="dispatcher and journal in one process, scripted steps, every joint state of the workflow",
    deadline=400.0,
)
async def every_state(lab: Lab) -> Evidence:
    """Forbidden operations are refused in every joint state."""
    workflows = ("ratms", "femoroplasty")
    blueprint = load_blueprint(find_workflow(workflows[lab.seed % len(workflows)]).blueprint)
    # In a thread, since it computes for seconds while the deadlines of other faults run.
    found = await asyncio.to_thread(asyncio.run, walk(blueprint, lab.folder))
    expect(not found.wrong, f"{len(found.wrong)} of {found.forbidden}: {'; '.join(found.wrong[:3])}")
    control = await asyncio.to_thread(asyncio.run, walk(blueprint, _folder(lab), _without_guard(blueprint), 1))
    expect(bool(control.wrong), "A guard was removed, and nothing was found.")
    return Evidence(
        f"{found.forbidden} refused in {found.joint_states} joint states",
        took_place={"refusals that the journal has": found.recorded},
        control_kind="mutant",
        control={"found with one guard removed": control.wrong[0]},
        details={"workflow": blueprint.id, "joint_states": found.joint_states, "forbidden": found.forbidden},
    )


def _folder(lab: Lab) -> Path:
    folder = lab.folder / "control"
    folder.mkdir()
    return folder


def _without_guard(blueprint: Blueprint) -> Blueprint:
    """Return the same workflow, in which an approach requires nothing but its own branch."""
    branch = blueprint.branches["placement"]
    freed = msgspec.structs.replace(branch.operations["approach"], requires={})
    changed = msgspec.structs.replace(branch, operations={**branch.operations, "approach": freed})
    return msgspec.structs.replace(blueprint, branches={**blueprint.branches, "placement": changed})


@fault(
    "O1", how="a running daemon, on its way to the placed tool, with requests over the bus for all forbidden operations"
)
async def all_forbidden(lab: Lab) -> Evidence:
    """Forbidden operations are refused by a complete daemon."""
    blueprint = load_blueprint(find_workflow("ratms").blueprint)
    rulings, requested, states = behaviour(blueprint), 0, 0
    async with lab.cell() as cell:
        row = cell.last_row()
        for step in _procedure_steps():
            if step is not None:
                await step(cell.client)
                await until(cell.client, lambda snapshot: not snapshot.running)
            requested += await _ask_forbidden(cell, blueprint, rulings)
            states += 1
        decisions = Counter(stored.verdict.decision for stored in cell.rows(row) if stored.verdict is not None)
        reached = await state(cell.client, "placement")
    return Evidence(
        f"{requested} refused in {states} joint states",
        took_place={"refusals that the journal has": decisions["rejected"]},
        control_kind="permitted",
        control={"accepted in other states, as the journal has it": decisions["accepted"], "reached": reached},
    )


def _procedure_steps() -> tuple[Callable[[Client], Awaitable[object]] | None, ...]:
    async def planned(client: Client) -> None:
        await accept(client, "registration.plan_landmarks", **landmarks())

    async def all_digitized(client: Client) -> None:
        await accept(client, "digitization.digitize_all")

    return None, planned, all_digitized, register, to_standoff, to_placed


async def _ask_forbidden(cell: RunningCell, blueprint: Blueprint, rulings: Any) -> int:
    """Request every operation that is denied in the present joint state, and return how many these are."""
    before, row = await cell.client.state(), cell.last_row()
    there = rulings[joint_of(blueprint, before.branches)]
    arguments = TourArguments(plan_arguments(plan()))
    denied = [
        (f"{branch}.{name}", spec.payload)
        for branch, name, spec in operations(blueprint)
        if spec.event or spec.iio or isinstance(there[f"{branch}.{name}"], Denial)
    ]
    # A watch decides whether the tool counts as aligned, and may do so in these states at any time.
    denied = [(name, payload) for name, payload in denied if not name.startswith("alignment.") and not is_sham()]
    verdicts = [await cell.client.call(name, arguments.next(name, payload)) for name, payload in denied]
    after, recorded = await cell.client.state(), [stored.verdict for stored in cell.rows(row)]
    for verdict in verdicts:
        expect(verdict.decision == "rejected", f"{verdict.branch}.{verdict.operation} was {verdict.decision}.")
        expect(verdict in recorded, f"The journal has no row of {verdict.branch}.{verdict.operation}.")
    if after.branches["alignment"] == before.branches["alignment"]:
        expect(shape(after) == shape(before), f"The state changed: {before} became {after}.")
    return len(verdicts)


@fault("O2", how="index beyond the plan, negative and far off, over the bus and over UDP")
async def index_out_of_range(lab: Lab) -> Evidence:
    """A landmark that is not planned is not digitized."""
    async with lab.cell() as cell:
        whole = landmarks()["landmarks"]
        count = len(whole) - 1
        await accept(cell.client, "registration.plan_landmarks", landmarks=whole[:count])
        indices = (0,) if is_sham() else (-1, count, lab.random.randrange(count, 10**6))
        codes = []
        for index in indices:
            verdict = await refused(
                cell, "digitization.digitize_one", {"index": index}, codes=("no_such_landmark", "bad_arguments")
            )
            codes.append(f"{index}: {reason_text(verdict)}")
        before = await cell.client.state()
        answer = await cell.planner.command("img_dig_digitize", count, timeout=30.0)
        expect(answer.decision == "rejected", f"Over UDP it was {answer.decision}.")
        expect(shape(await cell.client.state()) == shape(before), "The state changed.")
        await accept(cell.client, "registration.plan_landmarks", landmarks=whole)
        control = await accept(cell.client, "digitization.digitize_one", index=count)
        datagram = await cell.planner.command("img_dig_digitize", count, timeout=30.0)
        expect(datagram.decision == "accepted", f"Over UDP it was {datagram.decision} although it is planned.")
    return Evidence(
        f"refused: {reason_text(verdict)}",
        took_place={"the daemon says of each index": codes, "of the datagram": answer.decision},
        control_kind="permitted",
        control={f"index {count} once it is planned": control.decision, "the datagram": datagram.decision},
    )


NO_GATES = ("a_registration_that_was_not_accepted", "landmarks_in_a_line_or_mirrored", "a_coordinate_in_millimetres")
"""Guards that refuse landmarks which fit no registration."""


async def _register_displaced(lab: Lab, cell: RunningCell, offsets: dict[int, Any]) -> Evidence:
    """Digitize with touches off by `offsets` (m, by index): registering is refused, and accepted without the gates."""
    await _digitize_displaced(cell, offsets)
    verdict = await refused(cell, "registration.register", codes=GATES)
    await refused(cell, "placement.approach", codes=("requirement_not_met", "invalid_in_state", "parent_refuses"))
    await digitize_landmarks(cell.client)
    exact = await accept(cell.client, "registration.register")
    async with lab.daemon(prefix=without_guards(*NO_GATES)) as other:
        await _digitize_displaced(other, offsets)
        control = await accept(other.client, "registration.register")
    reason = verdict.reason
    return Evidence(
        f"registration refused: {reason.code if reason is not None else ''}",
        took_place={"the daemon's fit of the touches": reason_text(verdict)},
        control_kind="mutant",
        control={"the same touches without the gates": control.decision, "without the error": exact.decision},
    )


async def _digitize_displaced(cell: RunningCell, offsets: dict[int, Any]) -> None:
    await accept(cell.client, "registration.plan_landmarks", **landmarks())
    for index, offset in offsets.items():
        x, y, z = map(float, offset)
        if not is_sham():
            await cell.scene.displace_touch(index, (x, y, z))
    await accept(cell.client, "digitization.digitize_all")


def _points() -> Any:
    return np.array([landmark.position for landmark in plan().landmarks])


@fault("O3", how="simulated person touches two landmarks in exchanged order")
async def swapped(lab: Lab) -> Evidence:
    """Landmarks in another order are not accepted as a registration."""
    points = _points()
    first, second = lab.random.sample(range(len(points)), 2)
    offset = points[second] - points[first]
    async with lab.cell() as cell:
        evidence = await _register_displaced(lab, cell, {first: offset, second: -offset})
    return replace(evidence, details={"landmarks": f"{first}, {second}"})


@fault("O4", how="simulated person touches 25 mm or more beside a landmark")
async def large_residual(lab: Lab) -> Evidence:
    """A landmark far off is not accepted as a registration."""
    index, direction = lab.random.randrange(len(_points())), np.array([lab.random.gauss(0, 1) for _ in range(3)])
    offset = lab.random.uniform(0.025, 0.050) * direction / np.linalg.norm(direction)
    async with lab.cell() as cell:
        evidence = await _register_displaced(lab, cell, {index: offset})
    return replace(evidence, details={"landmark": index, "millimetres": float(np.linalg.norm(offset) * 1e3)})


@fault("O5", how="landmarks planned on one line")
async def collinear(lab: Lab) -> Evidence:
    """Landmarks on a line are not accepted as a plan."""
    step = lab.random.uniform(0.01, 0.05)
    line = [{"name": f"p{n}", "position": [step * n, 2 * step * n, 0.0]} for n in range(6)]
    codes = ("degenerate_points", "landmarks_collinear")
    async with lab.cell() as cell:
        requested = landmarks() if is_sham() else {"landmarks": line}
        verdict = await refused(cell, "registration.plan_landmarks", requested, codes=codes)
        usual = await accept(cell.client, "registration.plan_landmarks", **landmarks())
    async with lab.daemon(prefix=without_guards("landmarks_on_a_line_are_planned")) as other:
        control = await accept(other.client, "registration.plan_landmarks", **requested)
    return Evidence(
        f"refused: {reason_text(verdict)}",
        took_place={"the daemon's words": reason_text(verdict)},
        control_kind="mutant",
        control={"the same landmarks without the guard": control.decision, "the example's": usual.decision},
    )


def _patient(name: str) -> tuple[str, ...]:
    """Return the settings of a patient without a surface."""
    return f"procedure.patient={name}", 'procedure.body.surface=""'


@fault("O6", how="the daemon is started for another patient on the journal of the last one", deadline=300.0)
async def previous_patient(lab: Lab) -> Evidence:
    """The registration of another patient is not accepted."""
    async with lab.daemon(*_patient("one")) as cell:
        await digitize_landmarks(cell.client)
        await accept(cell.client, "registration.register")
    async with lab.daemon(*_patient("one" if is_sham() else "two"), folder=cell.folder) as other:
        verdict = await refused(other, "registration.use_previous", codes=("other_patient",))
    async with lab.daemon(*_patient("one"), folder=cell.folder) as same:
        control = await accept(same.client, "registration.use_previous")
    return Evidence(
        f"refused: {reason_text(verdict)}",
        took_place={"the daemon's words": reason_text(verdict)},
        control_kind="permitted",
        control={"for the same patient": control.decision},
    )


@fault("O7", how="landmarks are planned again, as many as before, while the head is registered")
async def planned_again(lab: Lab) -> Evidence:
    """A new plan ends digitization and registration."""
    async with lab.cell() as cell:
        await register(cell.client)
        before = (await cell.client.state()).registration
        if not is_sham():
            await accept(cell.client, "registration.plan_landmarks", **landmarks())
        shown = await cell.client.state()
        states = (shown.branches["registration"], shown.branches["digitization"], shown.registration)
        expect(states == ("100", "0", None), f"registration, digitization and id are {states}.")
        await refused(cell, "registration.register", codes=("invalid_in_state",))
        await refused(cell, "placement.approach", codes=("requirement_not_met", "invalid_in_state"))
        await accept(cell.client, "digitization.digitize_all")
        control = await accept(cell.client, "registration.register")
    return Evidence(
        "digitization and registration gone, approach refused",
        took_place={"registration until the new plan": before, "states after it": states},
        control_kind="permitted",
        control={"register, digitized again": control.decision},
    )


@fault("O8", how="landmarks planned in mm; the person touches the mirror image of every landmark")
async def wrong_units(lab: Lab) -> Evidence:
    """Another unit, or a mirror image, is not accepted as a registration."""
    given = landmarks()["landmarks"]
    in_mm = [{**each, "position": [1e3 * value for value in each["position"]]} for each in given]
    points = _points()
    middle = points.mean(axis=0)
    normal = np.array([lab.random.gauss(0, 1) for _ in range(3)])
    normal /= np.linalg.norm(normal)
    mirrored = points - 2.0 * np.outer((points - middle) @ normal, normal)
    async with lab.cell() as cell:
        requested = landmarks() if is_sham() else {"landmarks": in_mm}
        unit = await refused(cell, "registration.plan_landmarks", requested, codes=("wrong_unit",))
        mirror = await _register_displaced(lab, cell, dict(enumerate(mirrored - points)))
    async with lab.daemon(prefix=without_guards(*NO_GATES)) as other:
        control = await accept(other.client, "registration.plan_landmarks", **requested)
    return replace(
        mirror,
        response=f"mm: {reason_text(unit)}; mirror image: {mirror.response}",
        took_place={"the daemon's words of mm": reason_text(unit), **mirror.took_place},
        control={"mm without the guard": control.decision, **mirror.control},
    )


@fault("O10", how="commands with an id that was used: at once, later, and while the first runs")
async def repeated(lab: Lab) -> Evidence:
    """A command id is executed once."""
    async with lab.cell() as cell:
        row, name = cell.last_row(), f"again-{lab.random.random()}"
        arguments = landmarks()
        ids = (name, f"{name}-b") if is_sham() else (name, name)
        both = [cell.client.call("registration.plan_landmarks", arguments, id=each) for each in ids]
        first, second = await asyncio.gather(*both)
        await accept(cell.client, "digitization.digitize_all")
        third = await cell.client.call("registration.plan_landmarks", arguments, id=name)
        expect(first == second == third, f"Three verdicts for one id: {first}, {second}, {third}.")
        shown = (await cell.client.state()).branches
        expect(shown["digitization"] == "1", "The repeat was run: the digitization is gone.")
        outcomes = [stored for stored in cell.rows(row) if (stored.kind, stored.command_id) == ("outcome", name)]
        expect(len(outcomes) == 1, f"The journal has {len(outcomes)} outcomes of one id.")
        other = await accept(cell.client, "registration.plan_landmarks", **arguments)
        expect(other.sequence > first.sequence, "Another id was not run.")
    return Evidence(
        "run once, the recorded verdict thrice",
        took_place={"verdicts received for one id": sum(each.sequence == first.sequence for each in (second, third))},
        control_kind="permitted",
        control={"another id is run, rows later": other.sequence - first.sequence},
    )


STOPS = 9
PROMISE = 0.020
"""Time after a Stop within which a digitization is cancelled, s."""


@fault(
    "O11", how="Stop over UDP while the simulated person reaches for a landmark; the median of 9 counts", deadline=180
)
async def stop_while_digitizing(lab: Lab) -> Evidence:
    """Stop ends a digitization at once."""
    took: list[float] = []
    async with lab.daemon("sim.digitization.reach_time=25") as cell:
        await connect(cell.client)
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
        row = cell.last_row()
        for _ in range(STOPS):
            took.append(await _stop_digitizing(cell))
            await accept(cell.client, "robot.acknowledge")
            expect((await cell.client.state()).branches["digitization"] == "0", "Something was digitized.")
        stops = sum((stored.kind, stored.operation) == ("device", "stopped") for stored in cell.rows(row))
        control = await cell.client.call("digitization.digitize_one", {"index": 0}, timeout=30.0)
        expect(control.decision == "accepted", f"Without a Stop it was {control.decision}: {reason_text(control)}.")
    late = await _timer_lateness()
    if median(took) > PROMISE:
        raise Unmet(
            f"Cancelled after {median(took) * 1e3:.1f} ms in the median; a bare timer is {late * 1e3:.1f} ms late."
        )
    values = {"median_ms": median(took) * 1e3, "worst_ms": max(took) * 1e3, "timer_worst_ms": late * 1e3}
    return Evidence(
        f"cancelled within {values['median_ms']:.1f} ms",
        took_place={"Stops that the journal has": stops},
        control_kind="permitted",
        control={"the same digitization without a Stop": control.decision},
        details=values,
    )


async def _stop_digitizing(cell: RunningCell) -> float:
    """Return the time from the datagram of Stop to the cancelled operation's verdict at its caller, s."""
    clock = SystemClock()
    call = asyncio.create_task(cell.client.call("digitization.digitize_one", {"index": 0}, timeout=30.0))
    await until(cell.client, lambda snapshot: bool(snapshot.running))
    expect(not call.done(), "The digitization ended without a Stop.")
    started = clock.monotonic()
    stop = None if is_sham() else asyncio.create_task(cell.planner.stop())
    verdict = await call
    took = clock.monotonic() - started
    if stop is not None:
        await stop
    expect(verdict.decision == "failed", f"The digitization was {verdict.decision}.")
    return took


async def _timer_lateness() -> float:
    """Return the largest lateness of 100 bare timers of 5 ms, s."""
    clock, late = SystemClock(), list[float]()
    for _ in range(100):
        due = clock.monotonic() + 0.005
        await clock.sleep(0.005)
        late.append(clock.monotonic() - due)
    return max(late)


@fault("O12", how="another pose and other landmarks are planned while the tool moves to the first one")
async def edited_while_moving(lab: Lab) -> Evidence:
    """A plan cannot change during a motion."""
    async with lab.cell(*REAL_TIME) as cell:
        await to_retracted(cell.client)
        before = await cell.client.state()
        async with moving(cell.client) as approach:
            if is_sham():  # requested after the motion, it is no fault
                await approach
            joints = await cell.client.request_device("robot", "joints")
            speed = float(np.abs(joints["velocities"]).max())
            row, meanwhile = cell.last_row(), await cell.client.state()
            pose = await cell.client.call("toolplan.plan", tool_pose(1))
            await check_refused(cell, pose, meanwhile, row, ("busy",))
            points = await cell.client.call("registration.plan_landmarks", landmarks())
            await check_refused(cell, points, meanwhile, row, ("busy",))
            verdict = await approach
        expect(verdict.decision == "accepted", f"The approach was {verdict.decision}: {reason_text(verdict)}.")
        expect((await cell.client.state()).plan == before.plan, "The plan was changed.")
        control = await accept(cell.client, "toolplan.plan", **tool_pose(1))
        await until(cell.client, lambda snapshot: snapshot.branches["placement"] == "replanned")
        revoked = await state(cell.client, "placement")
    return Evidence(
        f"refused: {reason_text(pose)}",
        took_place={
            "a joint moves, rad/s": speed if speed > MOVES else 0.0,
            "runs": [each.operation for each in meanwhile.running],
        },
        control_kind="permitted",
        control={"planned when the tool stands": control.decision, "the standoff is": revoked},
    )


LIMIT = 3.0
"""Time without attendance after which a session is made safe here, s of the machine."""
ATTENDED = 6.0
ABANDONED_EVENT = "session_abandoned"
ABANDONED = (f"procedure.abandoned_after={LIMIT:g}", "workflow=ratms_threshold", *REAL_TIME)


@fault("O13", how="the operator leaves with the stimulator armed and the tool on the head; the limit is 3 s here")
async def abandoned(lab: Lab) -> Evidence:
    """A session that nobody attends to is made safe."""
    async with lab.daemon(*ABANDONED) as cell:
        return await _abandon_session(cell)


async def _abandon_session(cell: RunningCell) -> Evidence:
    await to_placed(cell.client)
    await accept(cell.client, "stimulation.set_ceiling", percent=80.0, operator="simulated operator")
    await accept(cell.client, "stimulation.set_intensity", percent=50.0)
    await accept(cell.client, "stimulation.arm")
    row = cell.last_row()
    async with _attended(cell.client):
        await asyncio.sleep(ATTENDED)
    expect(not (await cell.client.state()).latched, "The cell was held although it was attended.")
    attended = _longest_silence(cell.rows(row))
    async with _attended(cell.client) if is_sham() else nullcontext():
        shown = await until(
            cell.client, lambda snapshot: snapshot.latched and snapshot.branches["stimulation"] == "disarmed"
        )
    quiet = _longest_silence(cell.rows(row))
    stimulator = await cell.client.request_device("stimulator", "state")
    expect(not stimulator["armed"], "The stimulator itself is armed.")
    await stands(cell)
    await confirmed(cell)
    return Evidence(
        "held, latched, stimulator disarmed",
        took_place={"nobody has asked for anything for_s": quiet if quiet >= LIMIT else 0.0},
        control_kind="permitted",
        control={f"{ATTENDED:g} s with somebody there, who is never silent for longer than_s": attended},
        details={"placement": shown.branches["placement"]},
    )


@asynccontextmanager
async def _attended(client: Client) -> AsyncIterator[None]:
    """Request an operation regularly within the limit during the context."""

    async def request_repeatedly() -> None:
        while True:
            await client.call("stimulation.set_intensity", {"percent": 50.0})
            await asyncio.sleep(LIMIT / 2)

    requesting = asyncio.create_task(request_repeatedly())
    try:
        yield
    finally:
        requesting.cancel()
        with suppress(asyncio.CancelledError):
            await requesting


def _longest_silence(rows: list[JournalRow]) -> float:
    """Return the longest time between two rows about a command, or about its absence, s."""
    times = [row.monotonic for row in rows if row.kind == "outcome" or row.operation == ABANDONED_EVENT]
    return max((later - earlier for earlier, later in pairwise(times)), default=0.0)
