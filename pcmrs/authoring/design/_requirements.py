"""The requirements of a table, which speak of steps, as properties of the blueprint, which speak of states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pcmrs.authoring.design._branches import DesignedBranch
from pcmrs.authoring.design._grouping import UndesignableError
from pcmrs.authoring.design.tables import RequirementSpec
from pcmrs.fsm.blueprint import Condition, PropertySpec, Requirement
from pcmrs.fsm.finding import Finding, Path, hint


def properties_of(
    requirements: Sequence[RequirementSpec], branches: Sequence[DesignedBranch]
) -> Iterator[PropertySpec]:
    """Return a property for each requirement, in the same order.

    Args:
        requirements: Requirements of the table.
        branches: All designed branches.

    Raises:
        UndesignableError: A requirement names an unknown step or operation, or is not of the form that it must have.
    """
    for i, each in enumerate(requirements):
        yield _Reader(branches, ("requirements", str(i))).property_of(each)


class _Reader:
    """Finder of the steps and operations that one requirement names.

    Args:
        branches: All designed branches.
        path: Path of the requirement in the table.
    """

    def __init__(self, branches: Sequence[DesignedBranch], path: Path) -> None:
        self._path = path
        self._steps = {flag: branch for branch in branches for flag in branch.spec.flags}
        self._operations = {command.name: branch for branch in branches for command in branch.commands}

    def property_of(self, given: RequirementSpec) -> PropertySpec:
        if bool(given.operation) == bool(given.step) or not (given.holds or given.lacks):
            text = f"{given.id} needs either `operation` or `step`, and at least one step in `holds` or `lacks`."
            raise UndesignableError(Finding(code="bad_property", text=text, path=self._path))
        if given.operation:
            when = Condition(running=[f"{self._branch_of(given.operation).name}.{given.operation}"])
        else:
            when = Condition(states=self._states({given.step: "1"}))
        digits = dict.fromkeys(given.holds, "1") | dict.fromkeys(given.lacks, "0")
        return PropertySpec(id=given.id, text=given.text, when=when, always=Condition(states=self._states(digits)))

    def _branch_of(self, operation: str) -> DesignedBranch:
        if operation not in self._operations:
            text = f"{operation!r} is not the operation of a step; {hint(operation, self._operations)}"
            raise UndesignableError(Finding(code="unknown_operation", text=text, path=self._path))
        return self._operations[operation]

    def _states(self, digits: dict[str, str]) -> Requirement:
        """Return for each branch its states with these digits, each the digit of a step."""
        found: Requirement = {}
        for step, digit in digits.items():
            if step not in self._steps:
                text = f"There is no step {step!r}; {hint(step, self._steps)}"
                raise UndesignableError(Finding(code="step_unknown", text=text, path=self._path))
            spec, name = self._steps[step].spec, self._steps[step].name
            place = spec.flags.index(step)
            found[name] = [state for state in found.get(name, list(spec.states)) if state[place] == digit]
        return found
