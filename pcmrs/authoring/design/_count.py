"""Number of possible combinations of steps in the single-level FSM, with reasons for the impossible ones.

Also the finding for steps that would make a blueprint too large to be read or verified.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod

from pcmrs.authoring.design._branches import DesignedBranch
from pcmrs.authoring.design._order import Order
from pcmrs.fsm.blueprint import BranchSpec
from pcmrs.fsm.files.load import BlueprintExamination
from pcmrs.fsm.files.toml import MAX_BYTES
from pcmrs.fsm.finding import Finding


@dataclass(frozen=True, slots=True)
class Impossible:
    """Combinations that have `step` without `missing`, on which it depends.

    Attributes:
        count: Number of combinations; each counts under the first dependency that it breaks.
    """

    step: str
    missing: str
    count: int


@dataclass(frozen=True, slots=True)
class Combinations:
    """The states of the single-level FSM.

    Attributes:
        steps: N, of which there are 2^N combinations.
        possible: Number of them that respect all dependencies.
        impossible: Reasons why the others do not.
    """

    steps: int
    possible: int
    impossible: tuple[Impossible, ...]

    def __str__(self) -> str:
        lines = [f"{self.possible} of the {2**self.steps} combinations of {self.steps} steps are possible."]
        lines += [f"  {each.count} have {each.step} without {each.missing}." for each in self.impossible]
        return "\n".join(lines)


def count_combinations(orders: Sequence[Order]) -> Combinations:
    """Count the combinations without listing the impossible ones, of which there may be very many.

    Args:
        orders: Orders of the level 1 branches; no step of one depends on a step of another.
    """
    impossible: list[Impossible] = []
    for i, order in enumerate(orders):
        others = prod(len(each.ideals) for each in orders[:i]) * 2 ** sum(map(len, orders[i + 1 :]))
        broken = [Impossible(step, missing, count * others) for step, missing, count in _broken(order)]
        impossible += [each for each in broken if each.count]
    possible = prod(len(order.ideals) for order in orders)
    return Combinations(sum(map(len, orders)), possible, tuple(impossible))


def _broken(order: Order) -> Iterator[tuple[str, str, int]]:
    """Return, for each dependency, the number of combinations in which it is the first that is broken.

    The dependencies of all earlier steps hold, so their combinations are among the possible ones; the
    later steps are free.
    """
    before = 0
    for place, step in enumerate(order.sequence):
        remaining = [each for each in order.ideals if not each & ~before]
        for name in dict.fromkeys(order.steps[step].depends_on):
            bit = 1 << order.index[name]
            lacking = sum(1 for each in remaining if not each & bit)
            remaining = [each for each in remaining if each & bit]
            yield order.steps[step].name, name, lacking << (len(order) - place - 1)
        before |= 1 << step


def excess_of(examination: BlueprintExamination, size: int, branches: Sequence[DesignedBranch]) -> Finding | None:
    """Return the finding for a table that makes too large a blueprint, at the step of the largest branch; else None.

    Args:
        examination: Examination of the blueprint.
        size: Size of the blueprint in bytes.
        branches: Branches of the blueprint.
    """
    if examination.readable and all(finding.code != "too_many_states" for finding in examination.findings):
        return None
    why = f"The blueprint would have {size} bytes; the limit is {MAX_BYTES}."
    why = examination.findings[0].text if size <= MAX_BYTES else why
    largest = max(branches, key=lambda branch: _size(branch.spec))
    points = ("refined_by", "points") if largest.spec.sequence else ()
    text = f"{why} Most is from {largest.name}, with {_size(largest.spec)} {'points' if points else 'states'}."
    return Finding(code="step_count", text=text, path=(*largest.path, *points))


def _size(spec: BranchSpec) -> int:
    sequence = spec.sequence
    return len(spec.states) if sequence is None else sequence.count or len(sequence.items)
