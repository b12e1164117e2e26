"""What a tour through a world with a will of its own still has to see, and the way to the nearest of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping

from pcmrs.authoring.trial.tour import Move, nearest, ways_out
from pcmrs.fsm.behaviour import Joint

DEFAULT_PATIENCE = 3
"""A move that has not ended as wanted so often is put aside."""

ORDER = ("rejected", "accepted", "unknown", "failed")
"""What is looked at first in a joint state: what changes nothing, then what goes well."""


class CoveragePlan:
    """Moves to be made; one that does not end as wanted is tried again, then put aside until others have been made.

    Args:
        moves: All moves that can be made in each joint state; each is to be made once.
        patience: By ``branch.operation``, how often a move is tried before it is put aside, where not the default.
    """

    def __init__(self, moves: Mapping[Joint, Iterable[Move]], patience: Mapping[str, int]) -> None:
        self._moves = {joint: list(there) for joint, there in moves.items()}
        self._left = {joint: sorted(there, key=_rank) for joint, there in self._moves.items() if there}
        self._patience = patience
        self._misses: Counter[Move] = Counter()
        self._aside: dict[Move, str] = {}
        self._blocked: set[Move] = set()
        self._gained = False

    def __len__(self) -> int:
        return sum(map(len, self._left.values())) + len(self._aside)

    def next(self, here: Joint, able: Callable[[Move], bool]) -> Move | None:
        """A wanted move here, or the first one of the way to the nearest; None where nothing can be reached.

        Args:
            here: The present joint state.
            able: Whether a move can be made at present.
        """
        for attempt in range(2):
            goals = {joint for joint, there in self._left.items() if any(map(able, there))}
            if here in goals:
                return next(filter(able, self._left[here]))
            path = nearest(lambda joint: self._ways(joint, able), here, goals)
            if path:
                return path[0]
            if attempt or not self._take_up():
                break
        return None

    def towards(self, here: Joint, goals: set[Joint], able: Callable[[Move], bool]) -> Move | None:
        """The first move of the way to one of `goals`; None where there is none or it is here."""
        path = nearest(lambda joint: self._ways(joint, able), here, goals)
        return path[0] if path else None

    def made(self, move: Move) -> None:
        """It has ended as it may; nothing more is wanted of it, but ways may lead over it."""
        self._blocked.discard(move)
        wanted = self._remove(move) or self._aside.pop(move, None) is not None
        self._gained = self._gained or wanted

    def missed(self, move: Move, reason: str) -> None:
        """It has not led where it was to; once too often, and it is put aside."""
        self._misses[move] += 1
        if self._misses[move] >= self._patience.get(move.name, DEFAULT_PATIENCE):
            self.put_aside(move, reason)

    def put_aside(self, move: Move, reason: str) -> None:
        """No way leads over it for now."""
        self._blocked.add(move)
        if self._remove(move):
            self._aside[move] = reason

    def drop(self, unwanted: Callable[[Move], bool]) -> list[Move]:
        """Take moves off the agenda for good and returns them; ways lead over them no more."""
        dropped = [move for there in self._left.values() for move in there if unwanted(move)]
        dropped += [move for move in self._aside if unwanted(move)]
        for move in dropped:
            self._remove(move)
            self._aside.pop(move, None)
        self._moves = {joint: [m for m in there if not unwanted(m)] for joint, there in self._moves.items()}
        return dropped

    def rest(self) -> dict[Move, str]:
        """What has not been seen, and why where it was tried."""
        return {move: "" for there in self._left.values() for move in there} | self._aside

    def _ways(self, joint: Joint, able: Callable[[Move], bool]) -> list[Move]:
        return ways_out(move for move in self._moves.get(joint, ()) if move not in self._blocked and able(move))

    def _remove(self, move: Move) -> bool:
        there = self._left.get(move.before, [])
        if move not in there:
            return False
        there.remove(move)
        if not there:
            del self._left[move.before]
        return True

    def _take_up(self) -> bool:
        """Another round with what was put aside, where something was gained since the last."""
        if not (self._gained and self._blocked):
            return False
        for move in self._aside:
            self._left.setdefault(move.before, []).append(move)
        self._aside.clear()
        self._blocked.clear()
        self._misses.clear()
        self._gained = False
        return True


def _rank(move: Move) -> tuple[int, bool]:
    return ORDER.index(move.decision), move.after != move.before
