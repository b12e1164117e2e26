"""A tour of commands that makes a workflow give every answer it can give in every joint state.

For each reachable joint state and each operation: the rejection, or every declared outcome, every refusing
check, and every step that refuses, raises, is late or leaves doubt.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Literal

import msgspec

from pcmrs.fsm.behaviour import Joint, Ruling, behaviour, endings, joint_of, operations
from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Denial

MAX_JOINT_STATES = 5_000
"""A tour through more would be millions of commands long."""

Principal = Literal["user", "device"]
How = Literal["", "refuses", "raises", "late", "silent"]

FAILURES: tuple[How, ...] = ("refuses", "raises", "late")


class Move(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One command of a tour and what must come of it.

    Attributes:
        branch: The branch asked.
        operation: What is asked for.
        asker: Who asks: operations that devices call are asked for by users too, in vain.
        ending: A declared outcome, ``failed``, ``unknown`` or ``rejected``.
        at: The check or step that ends it, where it does not end well.
        how: What that check or step does.
        code: Of the rejection, where the workflow itself rejects.
        before: The joint state in which it is asked.
        after: The joint state that must follow.
    """

    branch: str
    operation: str
    asker: Principal = "user"
    ending: str
    at: str = ""
    how: How = ""
    code: str = ""
    before: Joint
    after: Joint

    @property
    def name(self) -> str:
        """``branch.operation``."""
        return f"{self.branch}.{self.operation}"

    @property
    def decision(self) -> str:
        """What the verdict must say."""
        return self.ending if self.ending in ("failed", "unknown", "rejected") else "accepted"

    def __str__(self) -> str:
        where = f" ({self.at} {self.how})" if self.at else ""
        return f"{self.name}:{self.ending}{where}"


@dataclass(frozen=True, slots=True)
class Tour:
    """Commands in order, in stretches that each begin at the start of the workflow.

    Attributes:
        stretches: The commands; between two stretches the workflow is started anew.
        wanted: All that a tour has to do.
    """

    stretches: list[list[Move]]
    wanted: list[Move]


def plan_tour(blueprint: Blueprint, limit: int = MAX_JOINT_STATES) -> Tour:
    """A short tour: always to the nearest joint state in which something is left to do.

    Raises:
        BlueprintError: There are more than `limit` joint states.
    """
    moves = all_moves(blueprint, limit)
    ways = {joint: ways_out(there) for joint, there in moves.items()}
    left = {joint: deque(sorted(there, key=_leaves)) for joint, there in moves.items()}
    start = here = joint_of(blueprint, blueprint.initial())
    stretches: list[list[Move]] = [[]]
    while left:
        path = nearest(ways.__getitem__, here, left)
        if path is None:
            stretches.append([])
            here = start
            continue
        stretches[-1] += path
        here = path[-1].after if path else here
        while here in left:
            move = left[here].popleft()
            if not left[here]:
                del left[here]
            stretches[-1].append(move)
            here = move.after
    return Tour(stretches, [move for there in moves.values() for move in there])


def nearest(ways: Callable[[Joint], list[Move]], here: Joint, goals: Container[Joint]) -> list[Move] | None:
    """The shortest way from a joint state to one of `goals`, by the moves that lead elsewhere; None without any."""
    came: dict[Joint, Move | None] = {here: None}
    waiting = deque([here])
    while waiting:
        joint = waiting.popleft()
        if joint in goals:
            path: list[Move] = []
            while (move := came[joint]) is not None:
                path.append(move)
                joint = move.before
            return path[::-1]
        for move in ways(joint):
            if move.after not in came:
                came[move.after] = move
                waiting.append(move.after)
    return None


def ways_out(moves: Iterable[Move]) -> list[Move]:
    """One move to each other joint state, by something that goes well where there is such."""
    found: dict[Joint, Move] = {}
    for move in sorted(moves, key=lambda move: move.decision != "accepted"):
        if _leaves(move):
            found.setdefault(move.after, move)
    return list(found.values())


def all_moves(blueprint: Blueprint, limit: int = MAX_JOINT_STATES) -> dict[Joint, list[Move]]:
    """For each reachable joint state, every command of every tour there.

    Raises:
        BlueprintError: There are more than `limit` joint states.
    """
    return {
        joint: [
            move
            for branch, operation, spec in operations(blueprint)
            for move in _moves(blueprint, joint, branch, operation, spec, answers[f"{branch}.{operation}"])
        ]
        for joint, answers in behaviour(blueprint, limit).items()
    }


def _moves(
    blueprint: Blueprint, joint: Joint, branch: str, operation: str, spec: OperationSpec, said: Ruling
) -> Iterator[Move]:
    asked = Move(branch=branch, operation=operation, ending="rejected", before=joint, after=joint)
    if spec.iio or spec.event:
        code = "internal_operation" if spec.iio else "event_operation"
        yield msgspec.structs.replace(asked, code=code)
    if spec.iio:
        return
    asked = msgspec.structs.replace(asked, asker="device" if spec.event else "user")
    if isinstance(said, Denial):
        yield msgspec.structs.replace(asked, code=said.code)
        return
    for check in dict.fromkeys(spec.checks):
        yield msgspec.structs.replace(asked, at=check, how="refuses")
    for ending, change in endings(spec, said).items():
        ended = msgspec.structs.replace(asked, ending=ending, after=_after(blueprint, joint, change))
        yield from _at_steps(ended, list(dict.fromkeys(spec.steps)))


def _at_steps(move: Move, steps: list[str]) -> Iterator[Move]:
    """A failure or doubt may come of every step, in every way."""
    if move.decision == "accepted":
        yield move
        return
    hows: tuple[How, ...] = FAILURES if move.ending == "failed" else ("silent",)
    for step, how in product(steps, hows):
        yield msgspec.structs.replace(move, at=step, how=how)


def _after(blueprint: Blueprint, joint: Joint, change: Change | None) -> Joint:
    return joint if change is None else joint_of(blueprint, change.states)


def _leaves(move: Move) -> bool:
    return move.after != move.before
