"""A tour of commands that makes a workflow give every answer it can give in every joint state.

The moves for each reachable joint state and each operation: the rejection, or every declared outcome, every refusing
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
"""Limit of joint states; a longer tour would have millions of commands."""

Requester = Literal["user", "device"]
How = Literal["", "refuses", "raises", "late", "silent"]

FAILURES: tuple[How, ...] = ("refuses", "raises", "late")


class TourCommand(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One command of a tour and its expected result.

    Attributes:
        branch: Branch of the operation.
        operation: Name of the operation.
        asker: Kind of client that asks: users also ask for the operations of devices, and are rejected.
        ending: A declared outcome, ``failed``, ``unknown`` or ``rejected``.
        at: The check or step that ends it, if it does not succeed.
        how: Behaviour of that check or step.
        code: Code of the rejection, if the workflow itself rejects.
        before: The joint state in which it is asked.
        after: The joint state that must follow.
    """

    branch: str
    operation: str
    asker: Requester = "user"
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
        """The expected decision of the verdict."""
        return self.ending if self.ending in ("failed", "unknown", "rejected") else "accepted"

    def __str__(self) -> str:
        where = f" ({self.at} {self.how})" if self.at else ""
        return f"{self.name}:{self.ending}{where}"


@dataclass(frozen=True, slots=True)
class Tour:
    """Commands in order, in stretches that each begin at the start of the workflow.

    Attributes:
        stretches: The commands; the workflow is restarted between two stretches.
        wanted: All moves that a tour has to make.
    """

    stretches: list[list[TourCommand]]
    wanted: list[TourCommand]


def plan_tour(blueprint: Blueprint, limit: int = MAX_JOINT_STATES) -> Tour:
    """Return a short tour: always to the nearest joint state in which something is left to do.

    Args:
        blueprint: The workflow.
        limit: Largest number of joint states.

    Raises:
        BlueprintError: There are more than `limit` joint states.
    """
    moves = all_moves(blueprint, limit)
    ways = {joint: exits(there) for joint, there in moves.items()}
    left = {joint: deque(sorted(there, key=_leaves)) for joint, there in moves.items()}
    start = here = joint_of(blueprint, blueprint.initial())
    stretches: list[list[TourCommand]] = [[]]
    while left:
        path = shortest_path(ways.__getitem__, here, left)
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


def shortest_path(
    ways: Callable[[Joint], list[TourCommand]], here: Joint, goals: Container[Joint]
) -> list[TourCommand] | None:
    """Return the shortest path from a joint state to one of `goals`, or None.

    Args:
        ways: Returns the moves out of a joint state.
        here: The first joint state.
        goals: Joint states.
    """
    came: dict[Joint, TourCommand | None] = {here: None}
    waiting = deque([here])
    while waiting:
        joint = waiting.popleft()
        if joint in goals:
            path: list[TourCommand] = []
            while (move := came[joint]) is not None:
                path.append(move)
                joint = move.before
            return path[::-1]
        for move in ways(joint):
            if move.after not in came:
                came[move.after] = move
                waiting.append(move.after)
    return None


def exits(moves: Iterable[TourCommand]) -> list[TourCommand]:
    """Return one move to each other joint state, if possible one that succeeds."""
    found: dict[Joint, TourCommand] = {}
    for move in sorted(moves, key=lambda move: move.decision != "accepted"):
        if _leaves(move):
            found.setdefault(move.after, move)
    return list(found.values())


def all_moves(blueprint: Blueprint, limit: int = MAX_JOINT_STATES) -> dict[Joint, list[TourCommand]]:
    """Return, for each reachable joint state, every command of every tour there.

    Args:
        blueprint: The workflow.
        limit: Largest number of joint states.

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
    blueprint: Blueprint, joint: Joint, branch: str, operation: str, spec: OperationSpec, ruling: Ruling
) -> Iterator[TourCommand]:
    command = TourCommand(branch=branch, operation=operation, ending="rejected", before=joint, after=joint)
    if spec.iio or spec.event:
        code = "internal_operation" if spec.iio else "event_operation"
        yield msgspec.structs.replace(command, code=code)
    if spec.iio:
        return
    command = msgspec.structs.replace(command, asker="device" if spec.event else "user")
    if isinstance(ruling, Denial):
        yield msgspec.structs.replace(command, code=ruling.code)
        return
    for check in dict.fromkeys(spec.checks):
        yield msgspec.structs.replace(command, at=check, how="refuses")
    for ending, change in endings(spec, ruling).items():
        ended = msgspec.structs.replace(command, ending=ending, after=_after(blueprint, joint, change))
        yield from _at_steps(ended, list(dict.fromkeys(spec.steps)))


def _at_steps(move: TourCommand, steps: list[str]) -> Iterator[TourCommand]:
    """Return a failure or doubt at every step, in every way."""
    if move.decision == "accepted":
        yield move
        return
    hows: tuple[How, ...] = FAILURES if move.ending == "failed" else ("silent",)
    for step, how in product(steps, hows):
        yield msgspec.structs.replace(move, at=step, how=how)


def _after(blueprint: Blueprint, joint: Joint, change: Change | None) -> Joint:
    return joint if change is None else joint_of(blueprint, change.states)


def _leaves(move: TourCommand) -> bool:
    return move.after != move.before
