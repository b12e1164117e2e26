"""Requests for every forbidden operation in every joint state of a workflow, through dispatcher and journal."""

from __future__ import annotations

import asyncio
import uuid
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from pcmrs.authoring.trial.tour import MAX_JOINT_STATES, TourCommand, plan_tour
from pcmrs.dispatcher import Dispatcher, ProcedureData
from pcmrs.dispatcher.command_checks import is_event
from pcmrs.fsm.behaviour import joint_of
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Command, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.rehearsal import LeapingClock, ScriptedSteps, scripted
from pcmrs_lab.campaign.sham import is_sham


@dataclass
class StateWalkResult:
    """Result of a walk through all joint states.

    Attributes:
        joint_states: Number of joint states.
        forbidden: Number of commands that had to be rejected.
        recorded: Number of refusals that were read back from the journal.
        wrong: Commands that were not rejected, changed something, or are missing in the journal (events must be
            missing).
    """

    joint_states: int = 0
    forbidden: int = 0
    recorded: int = 0
    wrong: list[str] = field(default_factory=list)


async def walk(
    blueprint: Blueprint, folder: Path, runs: Blueprint | None = None, enough: int | None = None
) -> StateWalkResult:
    """Request every forbidden operation in every joint state, and check the effects.

    Args:
        blueprint: Workflow that says what is forbidden.
        folder: Folder for the journal.
        runs: Workflow that decides; `blueprint` unless a difference is to be found.
        enough: Number of findings after which the walk ends.

    Returns:
        Numbers and findings of the walk.
    """
    tour = plan_tour(blueprint, MAX_JOINT_STATES)
    journal = Journal.open(folder / "every_state.sqlite", durable=False)
    try:
        found = StateWalkResult(len({move.before for move in tour.wanted}))
        for stretch in tour.stretches:
            if enough is not None and len(found.wrong) >= enough:
                break
            await _walk_stretch(blueprint, runs or blueprint, stretch, journal, found)
        return found
    finally:
        await journal.close()


async def _walk_stretch(
    blueprint: Blueprint, runs: Blueprint, moves: list[TourCommand], journal: Journal, found: StateWalkResult
) -> None:
    script, clock = ScriptedSteps(), LeapingClock()
    tag = BlueprintTag(id=runs.id, version=runs.version, hash=runs.hash)
    recorder = JournalRecorder(journal, clock, uuid.uuid4().hex, tag)
    dispatcher = Dispatcher(scripted(runs, script, outside=True), None, clock, recorder, _hold)
    for move in filter(_needed, moves):
        script.move = move
        before = _shape(dispatcher)
        command = _command(move)
        verdict = await dispatcher.submit(command)
        if move.decision == "rejected" and not move.at:
            found.forbidden += 1
            has_row = not is_event(runs, command)  # an event that changes nothing leaves no row
            wrong = _wrong(move, verdict, before == _shape(dispatcher), journal, has_row=has_row)
            found.wrong += [f"{move} in {'-'.join(move.before)}: {wrong}"] if wrong else []
            found.recorded += has_row and not wrong
        reached = joint_of(blueprint, dispatcher.snapshot().branches)
        if reached != move.after:
            found.wrong.append(f"{move} in {'-'.join(move.before)}: it led to {'-'.join(reached)}")
            break  # the rest of the stretch needs the expected state
        await asyncio.sleep(0)


def _needed(move: TourCommand) -> bool:
    """Return whether a command is forbidden or changes the state; other tests cover those that do neither."""
    return move.before != move.after or (move.decision == "rejected" and not move.at and not is_sham())


def _shape(dispatcher: Dispatcher[None, ProcedureData]) -> bytes:
    """Return states, flags, latch, number of the last commit, and data, encoded."""
    return msgspec.msgpack.encode((dispatcher.snapshot(), dispatcher.procedure.data))


def _wrong(move: TourCommand, verdict: Verdict, unchanged: bool, journal: Journal, *, has_row: bool) -> str:
    if verdict.decision != "rejected":
        return f"it was {verdict.decision}"
    if verdict.reason is None or verdict.reason.code != move.code:
        return f"refused as {verdict.reason}, expected {move.code}"
    if not unchanged:
        return "states or data have changed"
    stored = [row.row.verdict for row in journal.reader.read(last=1, kind="outcome")]
    if (stored == [verdict]) == has_row:
        return ""
    return "the journal has no row of it" if has_row else "the journal has a row of it"


def _command(move: TourCommand) -> Command:
    source = "device:campaign" if move.asker == "device" else "campaign:user"
    return Command(id=uuid.uuid4().hex, branch=move.branch, operation=move.operation, source=source)


async def _hold(_latch: bool) -> None:
    """Do nothing: there is no robot to hold."""
