"""The operations of a branch as the steps of a table ask for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pcmrs.authoring.design._grouping import StepGroup
from pcmrs.authoring.design._hazards import NONE, GuardedOrder, Hazard, hazard_of
from pcmrs.authoring.design.tables import ActionSpec, StepSpec
from pcmrs.fsm.finding import Finding, Path

REINIT = "reinit"
"""The re-initiation operation (RIO) that every designed branch has."""

MAKE_SAFE = "make_safe"
"""The operation with which people report that nothing is at the patient any more."""

Kind = Literal["achieve", "partial", "reopen", "signal", "unsignal", "make_safe", "allow"]
"""Effect of an operation on its step, or on all; signals are called by the branch that refines it (IIO)."""


@dataclass(frozen=True, slots=True)
class StepOperation:
    """An operation that a step asks for.

    Attributes:
        name: Name of the operation.
        kind: Effect on the step.
        step: Index of the step.
        action: Its action, with checks and payload.
        path: Path in the table.
        hazard: Effect on the patient.
        title: Its effect in words; empty if its name suffices.
    """

    name: str
    kind: Kind
    step: int
    action: ActionSpec
    path: Path
    hazard: Hazard = NONE
    title: str = ""


def operations_of(group: StepGroup, paths: Mapping[str, Path]) -> Iterator[StepOperation]:
    """Return the operations of a branch, in the order of its steps.

    Args:
        group: The steps of the branch.
        paths: Path of each step in the table.
    """
    for i, step in enumerate(group.order.steps):
        path = paths[step.name]
        yield from _signals(i, step, path) if step.refined_by else _ways(i, step, path)
        for j, reopener in enumerate(step.reopeners()):
            yield StepOperation(
                reopener.operation, "reopen", i, reopener, (*path, "reopened_by", str(j)), hazard_of(reopener)
            )
    if isinstance(group.order, GuardedOrder):
        yield from _reports(group.order, paths)


def _signals(index: int, step: StepSpec, path: Path) -> Iterator[StepOperation]:
    where, back = (*path, "operation"), f"un{step.operation}"
    yield StepOperation(step.operation, "signal", index, ActionSpec(operation=step.operation), where)
    yield StepOperation(back, "unsignal", index, ActionSpec(operation=back), where)


def _ways(index: int, step: StepSpec, path: Path) -> Iterator[StepOperation]:
    yield StepOperation(step.operation, "achieve", index, step, (*path, "operation"), hazard_of(step))
    for j, other in enumerate(step.alternatives):
        kind: Kind = "partial" if other.partial else "achieve"
        yield StepOperation(
            other.operation, kind, index, other, (*path, "alternatives", str(j)), hazard_of(other, step)
        )


def _reports(order: GuardedOrder, paths: Mapping[str, Path]) -> Iterator[StepOperation]:
    """Return the reports of the operator, who sees the patient."""
    if order.exposed or order.stopped:
        action = ActionSpec(operation=MAKE_SAFE, roles=["operator"])
        title = "Nothing is at or in the patient any more, and nothing moves"
        yield StepOperation(MAKE_SAFE, "make_safe", 0, action, paths[order.steps[0].name], title=title)
    for i in order.once:
        step = order.steps[i]
        action = ActionSpec(operation=f"allow_{step.operation}_again", roles=["operator"])
        title = f"Allow once more, though it cannot be undone: {step.operation.replace('_', ' ')}"
        yield StepOperation(action.operation, "allow", i, action, paths[step.name], title=title)


def check_operations(group: StepGroup, commands: Sequence[StepOperation]) -> Iterator[Finding]:
    """Return names that are used twice: steps may share only re-opening operations with the same declaration.

    Args:
        group: The steps of the branch.
        commands: Its operations.
    """
    seen: dict[str, StepOperation] = {}
    for command in commands:
        other = seen.setdefault(command.name, command)
        shared = command.kind == other.kind == "reopen" and command.action == other.action
        if command.name == REINIT or (other is not command and not shared):
            text = f"{group.name} would have two different operations {command.name!r}: rename one."
            yield Finding(code="name_collision", text=text, path=command.path)
