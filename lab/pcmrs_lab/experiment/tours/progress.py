"""Progress of a live tour: covered responses, and those still to cover."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from pcmrs.authoring.trial.coverage import Deviation, deviation
from pcmrs.authoring.trial.coverage_plan import CoveragePlan
from pcmrs.authoring.trial.tour import TourCommand
from pcmrs.fsm.behaviour import Joint
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.messages import Verdict

DECIDED_AT_ONCE = "is decided at once: Stop cannot come in between"


@dataclass
class TourObservations:
    """Result of a live tour.

    Attributes:
        wanted: All moves to cover, including those that cannot be covered live.
        made: Moves that were as required.
        deviations: Moves that were not as required.
        left: Moves that were not covered, with the reason.
        tour: Moves whose commands were sent, each with the requested ending.
        stops: Number of Stops that were pressed.
        events: Number of events that devices reported by themselves.
    """

    wanted: set[TourCommand]
    made: set[TourCommand] = field(default_factory=set)
    deviations: list[Deviation] = field(default_factory=list)
    left: dict[TourCommand, str] = field(default_factory=dict)
    tour: list[TourCommand] = field(default_factory=list)
    stops: int = 0
    events: int = 0


class TourProgress:
    """Comparison of each response with the required one, with the plan of the remaining moves.

    Args:
        blueprint: Workflow that the cell runs.
        moves: All moves to cover, by joint state.
        patience: Number of attempts by operation, as for `CoveragePlan`.

    Attributes:
        moves: All moves to cover, by joint state.
        agenda: Moves that are still to cover.
        seen: Result so far.
    """

    def __init__(
        self, blueprint: Blueprint, moves: Mapping[Joint, list[TourCommand]], patience: Mapping[str, int]
    ) -> None:
        self.moves = moves
        self.agenda = CoveragePlan(moves, patience)
        self.seen = TourObservations({move for there in moves.values() for move in there})
        self._blueprint = blueprint
        self._accepted: set[str] = set()

    def cover(self, moves: Iterable[TourCommand]) -> None:
        """Mark moves as covered."""
        for move in moves:
            self.agenda.made(move)
            self.seen.made.add(move)

    def drop(self, unwanted: Callable[[TourCommand], bool], reason: str) -> None:
        """Exclude moves that cannot be covered, with the reason.

        Args:
            unwanted: Returns whether a move is excluded.
            reason: Reason for the report.
        """
        self.seen.left |= dict.fromkeys(self.agenda.drop(unwanted), reason)

    def rejected(self, move: TourCommand, verdict: Verdict, sequence: int, after: Joint) -> None:
        """Judge a rejection: it is required, or comes from a check; in both cases it commits nothing after `sequence`.

        Args:
            move: TourCommand whose command was sent.
            verdict: Rejection.
            sequence: Number of the commit before the command.
            after: Joint state after it.
        """
        reason = verdict.reason
        code = reason.code if reason is not None else ""
        if verdict.sequence != sequence:
            self.judge(move, "rejected, yet something was committed", after, code)
        elif move.decision != "rejected" and reason is not None and "check" in reason.fields:
            self.agenda.missed(move, f"refused by its check: {code}")
        else:
            self.judge(move, "rejected", after, code)

    def ended(self, move: TourCommand, verdict: Verdict, after: Joint, *, ran: bool) -> None:
        """Judge an ended operation: every move that fits its ending is covered, even if another ending was requested.

        Args:
            move: Move whose command was sent.
            verdict: Verdict on it.
            after: Joint state that it led to.
            ran: True if the operation has ever been shown as running.
        """
        if verdict.decision == "accepted":
            self._accepted.add(move.name)
        fitting = [m for m in self.same(move) if (m.decision, m.after) == (verdict.decision, after)]
        self.cover(fitting)
        if not fitting:
            self.judge(move, verdict.decision, after, verdict.reason.code if verdict.reason is not None else "")
        elif move not in fitting:
            if move.name in self._accepted and not ran:
                self.drop(lambda m: m.name == move.name and m.decision == "failed", DECIDED_AT_ONCE)
            self.agenda.missed(move, f"the cell ended it otherwise: {fitting[0].ending}")

    def judge(self, move: TourCommand, decision: str, after: Joint, code: str) -> None:
        """Compare a response with the required one of a move.

        Args:
            move: TourCommand whose command was sent.
            decision: Decision on it.
            after: Joint state that it led to.
            code: Code of the reason; empty if there is none.
        """
        found = deviation(self._blueprint, move, decision, after, code)
        if found is None:
            self.cover([move])
        else:
            self.agenda.put_aside(move, "deviates")
            self.seen.made.discard(move)
            self.seen.deviations.append(found)

    def same(self, move: TourCommand) -> list[TourCommand]:
        """Return the moves of the same command in the same joint state."""
        command = (move.name, move.asker)
        return [other for other in self.moves[move.before] if (other.name, other.asker) == command]
