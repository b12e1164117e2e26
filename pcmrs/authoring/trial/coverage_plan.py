"""Plan of a tour through a live system that may not answer as wanted: the open moves, and the path to the nearest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping

from pcmrs.authoring.trial.tour import TourCommand, exits, shortest_path
from pcmrs.fsm.behaviour import Joint

DEFAULT_PATIENCE = 3
"""Number of misses after which a move is put aside."""

ORDER = ("rejected", "accepted", "unknown", "failed")
"""Order of decisions in a joint state: first those that change nothing, then those that succeed."""


class CoveragePlan:
    """Plan of the moves to be made. One that fails is tried again, then put aside until others have been made.

    Args:
        moves: All moves that can be made in each joint state; each is to be made once.
        patience: ``branch.operation`` to the number of tries before such a move is put aside, if not the default.
    """

    def __init__(self, moves: Mapping[Joint, Iterable[TourCommand]], patience: Mapping[str, int]) -> None:
        self._moves = {joint: list(there) for joint, there in moves.items()}
        self._left = {joint: sorted(there, key=_rank) for joint, there in self._moves.items() if there}
        self._patience = patience
        self._misses: Counter[TourCommand] = Counter()
        self._aside: dict[TourCommand, str] = {}
        self._blocked: set[TourCommand] = set()
        self._gained = False

    def __len__(self) -> int:
        return sum(map(len, self._left.values())) + len(self._aside)

    def next(self, here: Joint, able: Callable[[TourCommand], bool]) -> TourCommand | None:
        """Return a wanted move here, or the first move on the path to the nearest one; None if none can be reached.

        Args:
            here: The present joint state.
            able: Returns true if a move can be made at present.
        """
        for attempt in range(2):
            goals = {joint for joint, there in self._left.items() if any(map(able, there))}
            if here in goals:
                return next(filter(able, self._left[here]))
            path = shortest_path(lambda joint: self._ways(joint, able), here, goals)
            if path:
                return path[0]
            if attempt or not self._retry_aside():
                break
        return None

    def towards(self, here: Joint, goals: set[Joint], able: Callable[[TourCommand], bool]) -> TourCommand | None:
        """Return the first move on the path to one of `goals`; None if there is none, or it is here.

        Args:
            here: The present joint state.
            goals: Joint states.
            able: Returns true if a move can be made at present.
        """
        path = shortest_path(lambda joint: self._ways(joint, able), here, goals)
        return path[0] if path else None

    def made(self, move: TourCommand) -> None:
        """Note that a move has ended as wanted. It is not wanted again, but paths may use it."""
        self._blocked.discard(move)
        wanted = self._remove(move) or self._aside.pop(move, None) is not None
        self._gained = self._gained or wanted

    def missed(self, move: TourCommand, reason: str) -> None:
        """Note that a move has not ended as wanted. After too many misses, it is put aside.

        Args:
            move: The move.
            reason: Actual ending, for the report.
        """
        self._misses[move] += 1
        if self._misses[move] >= self._patience.get(move.name, DEFAULT_PATIENCE):
            self.put_aside(move, reason)

    def put_aside(self, move: TourCommand, reason: str) -> None:
        """Bar all paths over a move for now.

        Args:
            move: The move.
            reason: Reason, for the report.
        """
        self._blocked.add(move)
        if self._remove(move):
            self._aside[move] = reason

    def drop(self, unwanted: Callable[[TourCommand], bool]) -> list[TourCommand]:
        """Drop moves for good, bar all paths over them, and return them."""
        dropped = [move for there in self._left.values() for move in there if unwanted(move)]
        dropped += [move for move in self._aside if unwanted(move)]
        for move in dropped:
            self._remove(move)
            self._aside.pop(move, None)
        self._moves = {joint: [m for m in there if not unwanted(m)] for joint, there in self._moves.items()}
        return dropped

    def unseen(self) -> dict[TourCommand, str]:
        """Return the moves that have not been seen, each with the reason if it was tried."""
        return {move: "" for there in self._left.values() for move in there} | self._aside

    def _ways(self, joint: Joint, able: Callable[[TourCommand], bool]) -> list[TourCommand]:
        return exits(move for move in self._moves.get(joint, ()) if move not in self._blocked and able(move))

    def _remove(self, move: TourCommand) -> bool:
        there = self._left.get(move.before, [])
        if move not in there:
            return False
        there.remove(move)
        if not there:
            del self._left[move.before]
        return True

    def _retry_aside(self) -> bool:
        """Start another round with the moves that were put aside, if anything was gained since the last."""
        if not (self._gained and self._blocked):
            return False
        for move in self._aside:
            self._left.setdefault(move.before, []).append(move)
        self._aside.clear()
        self._blocked.clear()
        self._misses.clear()
        self._gained = False
        return True


def _rank(move: TourCommand) -> tuple[int, bool]:
    return ORDER.index(move.decision), move.after != move.before
