"""Effects of each command on each branch, as transitions with conditions on the other branches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pcmrs.authoring.exchange._cubes import Cube, cover
from pcmrs.authoring.exchange.exporting._coupling import Joint, combinations, coupled
from pcmrs.authoring.exchange.exporting._events import OperationEnding, changes_of, commands_by_operation
from pcmrs.authoring.exchange.exporting._nesting import Nesting
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Change

Entered = tuple[tuple[str, str], ...]
"""Branches and their target states."""


@dataclass(frozen=True, slots=True)
class Reaction:
    """A transition of one branch.

    Attributes:
        command: The operation and its ending that it reacts to.
        branch: The branch that reacts.
        source: The state in which it reacts.
        entered: The target states: of the branch, and of branches nested in it that do not enter their start
            there; empty if the command is accepted and keeps the state of the branch.
        guard: The states of other branches in which it reacts like this.
    """

    command: OperationEnding
    branch: str
    source: str
    entered: Entered
    guard: Cube

    @property
    def event(self) -> str:
        """Event of the transition."""
        return self.command.event


def reactions(blueprint: Blueprint, nesting: Nesting) -> Iterator[Reaction]:
    """Return all transitions, for every joint state in which children fit their parents.

    Args:
        blueprint: The workflow.
        nesting: The branches that are drawn inside others.

    Raises:
        BlueprintError: Too many branches depend on each other.
    """
    for asked, operation, endings in commands_by_operation(blueprint):
        branches = coupled(blueprint, asked, operation)
        before = [joint for joint in combinations(blueprint, branches) if nesting.holds(joint)]
        after = [changes_of(blueprint, joint, asked, operation) for joint in before]
        for command in endings:
            changes = [(joint, each.get(command.ending)) for joint, each in zip(before, after, strict=True)]
            for branch in branches:
                yield from _of_branch(command, branch, nesting, changes, [name for name in branches if name != branch])


def _of_branch(
    command: OperationEnding,
    branch: str,
    nesting: Nesting,
    changes: list[tuple[Joint, Change | None]],
    others: list[str],
) -> Iterator[Reaction]:
    reached: dict[str, dict[Entered | None, list[Joint]]] = {}
    for joint, change in changes:
        if nesting.active(branch, joint):
            entered = None if change is None else _entered(command, branch, nesting, joint, change)
            reached.setdefault(joint[branch], {}).setdefault(entered, []).append(joint)
    for source, leading in reached.items():
        for entered, wanted in leading.items():
            unwanted = [joint for other, joints in leading.items() if other != entered for joint in joints]
            for guard in cover(wanted, unwanted, others) if entered is not None else ():
                yield Reaction(command, branch, source, entered or (), guard)


def _entered(command: OperationEnding, branch: str, nesting: Nesting, before: Joint, change: Change) -> Entered | None:
    """Return the target of the branch itself: empty if it is the one asked and stays, None if it is not affected."""
    after = change.states
    if any(before[above] != after[above] for above in nesting.around(branch)):
        return None
    if before[branch] != after[branch]:
        return tuple(nesting.entered(branch, after))
    return () if branch == command.branch else None
