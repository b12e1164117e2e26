"""Tour through a running cell on simulated devices: every command over the bus, every answer compared.

The cell decides how an operation ends. So after each verdict the tour reads the state, and goes to the nearest joint
state in which a response is not covered yet. Steps fail because Stop is pressed while they run. The tour also records
the operations that activities and devices cause in between: a command is compared with the required response in the
joint state in which it arrived.
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
from pcmrs_lab.experiment.tours.arguments import TourArguments
from pcmrs_lab.experiment.tours.faults import FAULTS, fault
from pcmrs_lab.experiment.tours.observer import Observer
from pcmrs_lab.experiment.tours.progress import TourObservations, TourProgress

ANSWER_TIME = 120.0
"""Time within which any operation of a simulated cell has ended, s of the machine."""

REPORTED_WITHIN = 15.0
"""Time within which the loss of a device is reported, s."""

SHOWN_WITHIN = 1.0
"""Time within which the effect of a command is published, s."""

NO_FAULT = "the cell reports it by itself, and the tour has no simulated fault that causes it here"
NOT_REPORTED = "nothing in the cell reports it"
NEVER_SILENT = "no simulated device falls silent in the middle of an operation"
NOT_REACHED = "no path found into the joint states"
OUT_OF_TIME = "the time was up"

ShowProgress = Callable[[int, int], None]
"""Called with the number of covered responses and their total."""


class LiveTour:
    """Tour of a running cell whose responses are compared.

    Args:
        blueprint: Workflow that the cell runs.
        client: Client of the cell; no other client may command it meanwhile.
        observer: Observer of the same client.
        arguments: Arguments of the operations.
        limit: Largest number of joint states.

    Raises:
        BlueprintError: There are too many joint states.
    """

    def __init__(
        self, blueprint: Blueprint, client: Client, observer: Observer, arguments: TourArguments, limit: int
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
        """Run the tour.

        Args:
            seconds: Time after which no further command is sent, s.
            progress: Called after every command.

        Returns:
            Covered responses.

        Raises:
            UnknownOutcomeError: The cell does not answer any more.
        """
        loop, seen = asyncio.get_running_loop(), self._progress.seen
        end, why = loop.time() + seconds, OUT_OF_TIME
        state = await self._observer.settled()
        while loop.time() < end:
            move = self._next(state)
            if move is None:
                why = NOT_REACHED
                break
            state = await self._perform(move, state)
            progress(len(seen.made), len(seen.wanted) - len(seen.left))
        seen.left |= {move: reason or why for move, reason in self._progress.agenda.unseen().items()}
        for move in seen.made & seen.left.keys():
            del seen.left[move]  # given up, but covered by an event in between
        return seen

    def _next(self, state: Snapshot) -> TourCommand | None:
        """Return the next move; a latched Stop is released first, since nothing may move before."""
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

    async def _perform(self, move: TourCommand, before: Snapshot) -> Snapshot:
        """Send the command of a move and compare the response."""
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
        """Return the command in the joint state in which it arrived, and the number of the commit before.

        The cell may have left the joint state of the move by itself.
        """
        others = self._observer.verdicts_beside({*self._judged, verdict.id})
        earlier = [other for other in others if _precedes(other, verdict)]
        joint = self._take(*self._unrequested(move.before, earlier), earlier)
        if joint == move.before:
            return move, max([sequence, *(other.sequence for other in earlier)])
        self._progress.agenda.missed(move, "the cell changes its state by itself")
        there = [other for other in self._moves[joint] if (other.name, other.asker) == (move.name, move.asker)]
        return min(there, key=lambda other: other.ending != move.ending), max(other.sequence for other in earlier)

    def _led_to(self, move: TourCommand, verdict: Verdict, end: Joint) -> Joint:
        """Return the joint state that a decision led to if its snapshot was overtaken by the next one.

        The later verdicts must lead from there to the end.
        """
        endings = (other.after for other in self._progress.same(move) if other.decision == verdict.decision)
        return next((joint for joint in endings if self._final_joint(joint) == end), end)

    async def _command(self, move: TourCommand, before: Snapshot) -> Verdict:
        spec = self._blueprint.branches[move.branch].operations[move.operation]
        arguments, command_id = self._arguments.next(move.name, spec.payload), uuid.uuid4().hex
        if spec.unlatches:
            arguments = {"stop": before.stop.number} | arguments
        call = asyncio.create_task(self._client.call(move.name, arguments, id=command_id, timeout=ANSWER_TIME))
        try:
            if move.decision == "failed":
                await self._stop_while_running(call, command_id)
            return await call
        finally:
            call.cancel()

    async def _stop_while_running(self, call: asyncio.Task[Verdict], command_id: str) -> None:
        """Press Stop while the operation runs, but not if it has ended before it was shown as running."""
        running = asyncio.create_task(self._observer.running(command_id))
        await asyncio.wait((call, running), return_when=asyncio.FIRST_COMPLETED)
        running.cancel()
        if not call.done():
            self._progress.seen.stops += 1
            await self._client.stop(timeout=ANSWER_TIME)

    async def _provoke(self, move: TourCommand) -> Verdict | None:
        """Make a simulated device report an event, and end the fault; return None if nothing was reported in time."""
        async with fault(self._client, move.operation):
            with suppress(TimeoutError):
                async with asyncio.timeout(REPORTED_WITHIN):
                    return await self._observer.verdict_on(move.branch, move.operation, self._judged)
        return None

    async def _follow(self, move: TourCommand, joint: Joint, end: Joint) -> None:
        """Record operations that a step or a device has submitted; nothing else may have changed the state."""
        await self._shown(lambda: self._final_joint(joint) == end)
        others = self._observer.verdicts_beside(self._judged)
        reached = self._take(*self._unrequested(joint, others), others)
        if reached != end:
            self._progress.judge(move, "followed by an unrequested change", end, "")
        elif end != joint:
            self._progress.agenda.missed(move, "the cell changes its state by itself")

    async def _shown(self, condition: Callable[[], bool]) -> None:
        """Wait for a short time until a condition on the published messages holds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(SHOWN_WITHIN):
                await self._observer.shows(condition)

    def _take(self, unrequested: list[TourCommand], joint: Joint, verdicts: list[Verdict]) -> Joint:
        """Mark verdicts as judged and their moves as covered, and return the joint state that they led to."""
        self._judged |= {verdict.id for verdict in verdicts}
        self._progress.cover(unrequested)
        self._progress.seen.events += sum(made.asker == "device" for made in unrequested)
        return joint

    def _final_joint(self, joint: Joint) -> Joint:
        """Return the joint state to which the unrequested verdicts lead."""
        return self._unrequested(joint, self._observer.verdicts_beside(self._judged))[1]

    def _unrequested(self, joint: Joint, verdicts: list[Verdict]) -> tuple[list[TourCommand], Joint]:
        """Return the moves of unrequested verdicts that are as required, and the joint state that they lead to."""
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
    """Return the moves as visible from outside: without the refusing check and the stopped step."""
    found = (msgspec.structs.replace(move, at="", how="") for move in moves if not _by_check(move))
    return iter(dict.fromkeys(found))


def _by_check(move: TourCommand) -> bool:
    return bool(move.decision == "rejected" and move.at)


def _needs_arguments(name: str, move: TourCommand) -> bool:
    """Return whether a move requests an operation whose arguments are checked."""
    return move.name == name and move.code not in ("internal_operation", "event_operation")


def _provoked(move: TourCommand) -> bool:
    return move.operation in FAULTS and move.decision == "accepted"


def _precedes(other: Verdict, verdict: Verdict) -> bool:
    """Return whether a verdict was committed before another; a rejection has the number of the newest commit."""
    met = other.sequence == verdict.sequence and verdict.decision == "rejected"
    return other.decision != "rejected" and (other.sequence < verdict.sequence or met)
