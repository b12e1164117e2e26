"""Groups the steps of a table into State Branches: steps that are connected by dependencies share a branch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

from pcmrs.authoring.design._check import MAX_STEPS_OF_A_BRANCH
from pcmrs.authoring.design._hazards import GuardedOrder, is_hazardous
from pcmrs.authoring.design._order import MAX_COMBINATIONS, Order, TooManyCombinationsError
from pcmrs.authoring.design.tables import StepSpec
from pcmrs.fsm.finding import Finding, Path

UNNAMED = "procedure"
"""Name of the branch of steps that name none; followed by a number if there are several."""


@dataclass(frozen=True, slots=True)
class StepGroup:
    """The steps of one branch.

    Attributes:
        name: Name of the branch.
        title: Its title.
        order: Dependency order of its steps.
    """

    name: str
    title: str
    order: Order


class UndesignableError(Exception):
    """Steps that cannot form a branch; `finding` says why."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.text)
        self.finding = finding


def root_groups(steps: Sequence[StepSpec], paths: Mapping[str, Path]) -> list[StepGroup]:
    """Return the branches of level 1: the connected parts of the dependencies.

    Args:
        steps: Steps of the first level.
        paths: Path of each step in the table.

    Raises:
        UndesignableError: Connected steps name different branches, or are too many for one.
    """
    parts = _connected(steps)
    names = [_branch_name(part, paths) for part in parts]
    unnamed = (UNNAMED if number == 1 else f"{UNNAMED}_{number}" for number in count(1))
    return [group(name or next(unnamed), "", part, paths) for name, part in zip(names, parts, strict=True)]


def group(name: str, title: str, steps: Sequence[StepSpec], paths: Mapping[str, Path]) -> StepGroup:
    """Return steps as one branch.

    Args:
        name: Name of the branch.
        title: Its title.
        steps: Its steps.
        paths: Path of each step in the table.

    Raises:
        UndesignableError: There are too many steps or combinations.
    """
    where = paths[steps[0].name]
    if len(steps) > MAX_STEPS_OF_A_BRANCH:
        text = f"{name} would have {len(steps)} connected steps; the limit is {MAX_STEPS_OF_A_BRANCH}. Refine some."
        raise UndesignableError(Finding(code="step_count", text=text, path=where))
    try:
        order = GuardedOrder(name, steps) if is_hazardous(steps) else Order(steps)
    except TooManyCombinationsError:
        text = f"The {len(steps)} steps of {name} allow over {MAX_COMBINATIONS} combinations: refine some of them."
        raise UndesignableError(Finding(code="step_count", text=text, path=where)) from None
    if len(order.flags) > MAX_STEPS_OF_A_BRANCH:
        text = (
            f"The states of {name} would have {len(order.flags)} digits, one for each step and one more for each that "
        )
        text += f"is irreversible; the limit is {MAX_STEPS_OF_A_BRANCH}. Refine some."
        raise UndesignableError(Finding(code="step_count", text=text, path=where))
    return StepGroup(name, title, order)


def _connected(steps: Sequence[StepSpec]) -> list[list[StepSpec]]:
    parts = {step.name: {step.name} for step in steps}
    for step in steps:
        for name in step.depends_on:
            joined = parts[step.name] | parts[name]
            parts |= dict.fromkeys(joined, joined)
    unique = {id(part): part for part in (parts[step.name] for step in steps)}
    return [[step for step in steps if step.name in part] for part in unique.values()]


def _branch_name(part: Sequence[StepSpec], paths: Mapping[str, Path]) -> str:
    named = {step.branch: step for step in part if step.branch}
    if len(named) > 1:
        (first, _), (second, step) = list(named.items())[:2]
        text = f"{step.name} is to be in {second}, but steps connected with it in {first}: they share one branch."
        raise UndesignableError(Finding(code="step_branch", text=text, path=(*paths[step.name], "branch")))
    return next(iter(named), "")
