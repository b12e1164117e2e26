"""What a live tour has seen of a cell, and what it still wants to see."""

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
    """What a live tour has seen.

    Attributes:
        wanted: All there is to see, whether or not it can be seen live.
        made: What has been seen to be as it must.
        deviations: What was not as it must be.
        left: What was not seen, and why.
        tour: The commands that were given, each with the ending that was wanted.
        stops: How often Stop was pressed.
        events: How often a device reported something by itself.
    """

    wanted: set[TourCommand]
    made: set[TourCommand] = field(default_factory=set)
    deviations: list[Deviation] = field(default_factory=list)
    left: dict[TourCommand, str] = field(default_factory=dict)
    tour: list[TourCommand] = field(default_factory=list)
    stops: int = 0
    events: int = 0


class TourProgress:
    """Compares what came of each command with what must, and keeps the agenda.

    Args:
        blueprint: Of the workflow that the cell runs.
        moves: All there is to see in each joint state.
        patience: See `CoveragePlan`.

    Attributes:
        moves: The same.
        agenda: What is still wanted.
        seen: What has been seen.
    """

    def __init__(
        self, blueprint: Blueprint, moves: Mapping[Joint, list[TourCommand]], patience: Mapping[str, int]
    ) -> None:
        self.moves = moves
        self.agenda = CoveragePlan(moves, patience)
        self.seen = TourObservations({move for there in moves.values() for move in there})
        self._blueprint = blueprint
        self._accepted: set[str] = set()

    def saw(self, moves: Iterable[TourCommand]) -> None:
        """These have ended as they may."""
        for move in moves:
            self.agenda.made(move)
            self.seen.made.add(move)

    def drop(self, unwanted: Callable[[TourCommand], bool], reason: str) -> None:
        """Gives up for good what cannot be seen, and says why."""
        self.seen.left |= dict.fromkeys(self.agenda.drop(unwanted), reason)

    def rejected(self, move: TourCommand, verdict: Verdict, sequence: int, after: Joint) -> None:
        """A rejection is as it must be, or comes of a check; in any case it commits nothing after `sequence`."""
        reason = verdict.reason
        code = reason.code if reason is not None else ""
        if verdict.sequence != sequence:
            self.judge(move, "rejected, yet something was committed", after, code)
        elif move.decision != "rejected" and reason is not None and "check" in reason.fields:
            self.agenda.missed(move, f"refused by its check: {code}")
        else:
            self.judge(move, "rejected", after, code)

    def ended(self, move: TourCommand, verdict: Verdict, after: Joint, *, ran: bool) -> None:
        """Every ending that fits what has come of it has been seen, also where another one was wanted.

        Args:
            move: What was asked for.
            verdict: What was decided.
            after: The joint state that it led to.
            ran: Whether the operation has ever been shown as running.
        """
        if verdict.decision == "accepted":
            self._accepted.add(move.name)
        fitting = [m for m in self.same(move) if (m.decision, m.after) == (verdict.decision, after)]
        self.saw(fitting)
        if not fitting:
            self.judge(move, verdict.decision, after, verdict.reason.code if verdict.reason is not None else "")
        elif move not in fitting:
            if move.name in self._accepted and not ran:
                self.drop(lambda m: m.name == move.name and m.decision == "failed", DECIDED_AT_ONCE)
            self.agenda.missed(move, f"the cell ended it otherwise: {fitting[0].ending}")

    def judge(self, move: TourCommand, decision: str, after: Joint, code: str) -> None:
        """Compares with what the move must come to."""
        found = deviation(self._blueprint, move, decision, after, code)
        if found is None:
            self.saw([move])
        else:
            self.agenda.put_aside(move, "deviates")
            self.seen.made.discard(move)
            self.seen.deviations.append(found)

    def same(self, move: TourCommand) -> list[TourCommand]:
        """All ways in which the same command may end."""
        asked = (move.name, move.asker)
        return [other for other in self.moves[move.before] if (other.name, other.asker) == asked]
