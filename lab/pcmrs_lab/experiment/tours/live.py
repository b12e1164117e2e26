"""A tour through a running cell on simulated devices: every command over the bus, every answer compared.

How an operation ends is up to the cell, so the tour looks after each verdict where it is and goes to the
nearest joint state in which something is left to see. Steps fail because Stop is pressed while they run. What the
cell does by itself in between, as its activities and devices have it, is seen too: a command is compared with what
must come of it in the joint state that it met.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import msgspec

from pcmrs.authoring.trial.coverage_plan import DEFAULT_PATIENCE
from pcmrs.authoring.trial.tour import TourCommand, all_moves
from pcmrs.client import Client
from pcmrs.fsm.behaviour import Joint
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.messages import Snapshot, Verdict
from pcmrs_lab.experiment.tours.arguments import Arguments
from pcmrs_lab.experiment.tours.faults import FAULTS, fault
from pcmrs_lab.experiment.tours.observer import Observer
from pcmrs_lab.experiment.tours.progress import TourObservations, TourProgress

ANSWER_TIME = 120.0
"""Any operation of a simulated cell has ended after so many seconds of the machine."""

REPORTED_WITHIN = 15.0
"""A device that was cut off is missed within so many seconds."""

SHOWN_WITHIN = 1.0
"""What a cell has done is shown within so many seconds."""

NO_FAULT = "the cell reports it by itself, and the tour has no fault of the simulation that makes it do so here"
NOT_REPORTED = "nothing in the cell reports it"
NEVER_SILENT = "no simulated device falls silent in the middle of an operation"
NOT_REACHED = "no way found into the joint states"
OUT_OF_TIME = "the time was up"

ShowProgress = Callable[[int, int], None]
"""Told how much of how much is done."""


class LiveTour:
    """Goes through a cell and compares.

    Args:
        blueprint: Of the workflow that the cell runs.
        client: Of the cell; nobody else may command it meanwhile.
        observer: Of the same client.
        arguments: For the operations.
        limit: Most joint states.

    Raises:
        BlueprintError: There are too many joint states.
    """

    def __init__(
        self, blueprint: Blueprint, client: Client, observer: Observer, arguments: Arguments, limit: int
    ) -> None:
        self._blueprint = blueprint
        self._client = client
        self._observer = observer
        self._arguments = arguments
        self._moves = {joint: list(_live(there)) for joint, there in all_moves(blueprint, limit).items()}
        patience = {name: DEFAULT_PATIENCE + choices for name, choices in arguments.choices(blueprint).items()}
        self._progress = TourProgress(blueprint, self._moves, patience)
        self._judged: set[str] = set()
        self._progress.drop(lambda move: move.decision == "unknown", NEVER_SILENT)
        self._progress.drop(lambda move: move.asker == "device" and not _provoked(move), NO_FAULT)
        for name, payload in arguments.missing(blueprint).items():
            without = f"there are no arguments for it: give {payload} with --arguments"
            self._progress.drop(partial(_needs_arguments, name), without)

    async def run(self, seconds: float, progress: ShowProgress) -> TourObservations:
        """Sees what there is to see.

        Args:
            seconds: After so many seconds no further command is given.
            progress: Told after every command.

        Raises:
            UnknownOutcomeError: The cell fell silent.
        """
        loop, seen = asyncio.get_running_loop(), self._progress.seen
        end, why = loop.time() + seconds, OUT_OF_TIME
        state = await self._observer.settled()
        while loop.time() < end:
            move = self._next(state)
            if move is None:
                why = NOT_REACHED
                break
            state = await self._make(move, state)
            progress(len(seen.made), len(seen.wanted) - len(seen.left))
        seen.left |= {move: reason or why for move, reason in self._progress.agenda.unseen().items()}
        for move in seen.made & seen.left.keys():
            del seen.left[move]  # given up, and come by itself
        return seen

    def _next(self, state: Snapshot) -> TourCommand | None:
        """The next move: releases the latch first, without which nothing may move."""
        here, agenda = tuple(state.branches.values()), self._progress.agenda
        if not state.latched:
            return agenda.next(here, lambda _: True)
        releases = next(filter(self._unlatches, self._moves.get(here, ())), None)
        goals = {joint for joint, there in self._moves.items() if any(map(self._unlatches, there))}
        still = self._allowed_when_latched
        return releases or agenda.next(here, still) or agenda.towards(here, goals, still)

    def _unlatches(self, move: TourCommand) -> bool:
        spec = self._blueprint.branches[move.branch].operations[move.operation]
        return spec.unlatches and move.decision == "accepted"

    def _allowed_when_latched(self, move: TourCommand) -> bool:
        return not self._blueprint.branches[move.branch].operations[move.operation].blocked_when_latched

    async def _make(self, move: TourCommand, before: Snapshot) -> Snapshot:
        """Gives the command of a move and looks what has come of it."""
        self._progress.seen.tour.append(move)
        verdict = await (self._provoke(move) if move.asker == "device" else self._command(move, before))
        if verdict is None:
            self._progress.agenda.missed(move, NOT_REPORTED)
            return await self._observer.settled()
        after = await self._observer.settled(verdict.sequence)
        await self._shown(lambda: self._observer.has(verdict))
        move, sequence = self._met(move, verdict, before.sequence)
        self._judged.add(verdict.id)
        shown = self._observer.joint_at(verdict) or self._led_to(move, verdict, tuple(after.branches.values()))
        if verdict.decision == "rejected":
            self._progress.rejected(move, verdict, sequence, shown)
        else:
            self._progress.ended(move, verdict, shown, ran=move.name in self._observer.ran)
        await self._follow(move, shown, tuple(after.branches.values()))
        return after

    def _met(self, move: TourCommand, verdict: Verdict, sequence: int) -> tuple[TourCommand, int]:
        """The command where it met the cell, which may have gone on by itself, and the number of the commit before."""
        others = self._observer.verdicts_beside({*self._judged, verdict.id})
        earlier = [other for other in others if _precedes(other, verdict)]
        joint = self._take(*self._unasked(move.before, earlier), earlier)
        if joint == move.before:
            return move, max([sequence, *(other.sequence for other in earlier)])
        self._progress.agenda.missed(move, "the cell goes on by itself")
        there = [other for other in self._moves[joint] if (other.name, other.asker) == (move.name, move.asker)]
        return min(there, key=lambda other: other.ending != move.ending), max(other.sequence for other in earlier)

    def _led_to(self, move: TourCommand, verdict: Verdict, end: Joint) -> Joint:
        """Where a decision led whose snapshot was overtaken by the next: from there the rest must lead to the end."""
        endings = (other.after for other in self._progress.same(move) if other.decision == verdict.decision)
        return next((joint for joint in endings if self._goes_on(joint) == end), end)

    async def _command(self, move: TourCommand, before: Snapshot) -> Verdict:
        spec = self._blueprint.branches[move.branch].operations[move.operation]
        arguments, command_id = self._arguments.next(move.name, spec.payload), uuid.uuid4().hex
        if spec.unlatches:
            arguments = {"stop": before.stop.number} | arguments
        call = asyncio.create_task(self._client.call(move.name, arguments, id=command_id, timeout=ANSWER_TIME))
        try:
            if move.decision == "failed":
                await self._stop_once_begun(call, command_id)
            return await call
        finally:
            call.cancel()

    async def _stop_once_begun(self, call: asyncio.Task[Verdict], command_id: str) -> None:
        """Presses Stop while the operation runs; not at all where it has ended before it was shown to run."""
        begun = asyncio.create_task(self._observer.begun(command_id))
        await asyncio.wait((call, begun), return_when=asyncio.FIRST_COMPLETED)
        begun.cancel()
        if not call.done():
            self._progress.seen.stops += 1
            await self._client.stop(timeout=ANSWER_TIME)

    async def _provoke(self, move: TourCommand) -> Verdict | None:
        """Makes a simulated device report, and mends it; None when nothing was reported in time."""
        async with fault(self._client, move.operation):
            with suppress(TimeoutError):
                async with asyncio.timeout(REPORTED_WITHIN):
                    return await self._observer.verdict_on(move.branch, move.operation, self._judged)
        return None

    async def _follow(self, move: TourCommand, joint: Joint, end: Joint) -> None:
        """What a step has submitted or a device reported is seen too; nothing else may have moved the cell."""
        await self._shown(lambda: self._goes_on(joint) == end)
        others = self._observer.verdicts_beside(self._judged)
        reached = self._take(*self._unasked(joint, others), others)
        if reached != end:
            self._progress.judge(move, "then something that nobody asked for", end, "")
        elif end != joint:
            self._progress.agenda.missed(move, "the cell goes on by itself")

    async def _shown(self, condition: Callable[[], bool]) -> None:
        """Waits until a condition on what has been shown holds, but not for long."""
        with suppress(TimeoutError):
            async with asyncio.timeout(SHOWN_WITHIN):
                await self._observer.shows(condition)

    def _take(self, unasked: list[TourCommand], joint: Joint, verdicts: list[Verdict]) -> Joint:
        """These verdicts have been looked at, and the moves seen in them led to `joint`."""
        self._judged |= {verdict.id for verdict in verdicts}
        self._progress.saw(unasked)
        self._progress.seen.events += sum(made.asker == "device" for made in unasked)
        return joint

    def _goes_on(self, joint: Joint) -> Joint:
        """Where the verdicts that nobody asked for lead."""
        return self._unasked(joint, self._observer.verdicts_beside(self._judged))[1]

    def _unasked(self, joint: Joint, verdicts: list[Verdict]) -> tuple[list[TourCommand], Joint]:
        """The moves of verdicts that nobody asked for, as far as they are as they must be, and where they lead."""
        found: list[TourCommand] = []
        for verdict in verdicts:
            what, shown = (verdict.branch, verdict.operation, verdict.decision), self._observer.joint_at(verdict)
            there = self._moves.get(joint, []) if verdict.decision != "rejected" else []
            for move in there:
                if (move.branch, move.operation, move.decision) == what and shown in (None, move.after):
                    found.append(move)
                    joint = move.after
                    break
        return found, joint


def _live(moves: list[TourCommand]) -> Iterator[TourCommand]:
    """What may be seen of a cell from outside: not which check refused, nor which step was stopped."""
    found = (msgspec.structs.replace(move, at="", how="") for move in moves if not _by_check(move))
    return iter(dict.fromkeys(found))


def _by_check(move: TourCommand) -> bool:
    return bool(move.decision == "rejected" and move.at)


def _needs_arguments(name: str, move: TourCommand) -> bool:
    """Whether it asks for an operation in a way in which its arguments are looked at."""
    return move.name == name and move.code not in ("internal_operation", "event_operation")


def _provoked(move: TourCommand) -> bool:
    return move.operation in FAULTS and move.decision == "accepted"


def _precedes(other: Verdict, verdict: Verdict) -> bool:
    """Whether it was committed before; a rejection has the number of the newest commit that it met."""
    met = other.sequence == verdict.sequence and verdict.decision == "rejected"
    return other.decision != "rejected" and (other.sequence < verdict.sequence or met)
