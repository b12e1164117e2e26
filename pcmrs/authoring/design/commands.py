"""The operations of a branch as the steps of a table ask for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pcmrs.authoring.design.grouping import Group
from pcmrs.authoring.design.hazards import NONE, GuardedOrder, Hazard, hazard_of
from pcmrs.authoring.design.table import ActionSpec, StepSpec
from pcmrs.fsm.finding import Finding, Path

REINIT = "reinit"
"""The re-initiation operation (RIO) that every designed branch has."""

MAKE_SAFE = "make_safe"
"""The operation with which people say that nothing is at the patient any more."""

Kind = Literal["achieve", "partial", "reopen", "signal", "unsignal", "make_safe", "allow"]
"""What an operation does to its step, or to all; signals are called by the branch that refines it (IIO)."""


@dataclass(frozen=True, slots=True)
class Command:
    """An operation that a step asks for.

    Attributes:
        name: Of the operation.
        kind: What it does to the step.
        step: Index of the step.
        action: What is done, checked and given.
        path: Where the table asks for it.
        hazard: What it does to the patient.
        title: What it does, in words; empty where its name says enough.
    """

    name: str
    kind: Kind
    step: int
    action: ActionSpec
    path: Path
    hazard: Hazard = NONE
    title: str = ""


def commands_of(group: Group, paths: Mapping[str, Path]) -> Iterator[Command]:
    """The operations of a branch, in the order of its steps."""
    for i, step in enumerate(group.order.steps):
        path = paths[step.name]
        yield from _signals(i, step, path) if step.refined_by else _ways(i, step, path)
        for j, reopener in enumerate(step.reopeners()):
            yield Command(
                reopener.operation, "reopen", i, reopener, (*path, "reopened_by", str(j)), hazard_of(reopener)
            )
    if isinstance(group.order, GuardedOrder):
        yield from _reports(group.order, paths)


def _signals(index: int, step: StepSpec, path: Path) -> Iterator[Command]:
    where, back = (*path, "operation"), f"un{step.operation}"
    yield Command(step.operation, "signal", index, ActionSpec(operation=step.operation), where)
    yield Command(back, "unsignal", index, ActionSpec(operation=back), where)


def _ways(index: int, step: StepSpec, path: Path) -> Iterator[Command]:
    yield Command(step.operation, "achieve", index, step, (*path, "operation"), hazard_of(step))
    for j, other in enumerate(step.alternatives):
        kind: Kind = "partial" if other.partial else "achieve"
        yield Command(other.operation, kind, index, other, (*path, "alternatives", str(j)), hazard_of(other, step))


def _reports(order: GuardedOrder, paths: Mapping[str, Path]) -> Iterator[Command]:
    """What the operator, who sees the patient, says of it."""
    if order.exposed or order.stopped:
        action = ActionSpec(operation=MAKE_SAFE, roles=["operator"])
        title = "Nothing is at or in the patient any more, and nothing moves"
        yield Command(MAKE_SAFE, "make_safe", 0, action, paths[order.steps[0].name], title=title)
    for i in order.once:
        step = order.steps[i]
        action = ActionSpec(operation=f"allow_{step.operation}_again", roles=["operator"])
        title = f"Allow once more, though it cannot be undone: {step.operation.replace('_', ' ')}"
        yield Command(action.operation, "allow", i, action, paths[step.name], title=title)


def check_commands(group: Group, commands: Sequence[Command]) -> Iterator[Finding]:
    """Names used twice: only re-opening, told in the same words, may be shared by steps."""
    seen: dict[str, Command] = {}
    for command in commands:
        other = seen.setdefault(command.name, command)
        shared = command.kind == other.kind == "reopen" and command.action == other.action
        if command.name == REINIT or (other is not command and not shared):
            text = f"{group.name} would have two different operations {command.name!r}: rename one."
            yield Finding(code="name_collision", text=text, path=command.path)
