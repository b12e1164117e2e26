"""The state objects of a running workflow: one singleton per state class, one active in each branch."""

from __future__ import annotations

from collections.abc import Mapping

from pcmrs.errors import BlueprintError
from pcmrs.fsm._state import State
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.classes import states_of
from pcmrs.fsm.closure import Answer, Denial


class StateSet:
    """The singleton state objects of all branches, exactly one of each branch active.

    Args:
        blueprint: The loaded workflow; all branches start in their starting state.

    Raises:
        BlueprintError: A state class disagrees with the blueprint.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.objects: dict[str, dict[str, State]] = {
            branch: {kind.name: kind() for kind in kinds} for branch, kinds in states_of(blueprint).items()
        }
        self._all = [state for objects in self.objects.values() for state in objects.values()]
        self._check_answers(blueprint)
        self._active = {name: self.objects[name][state] for name, state in blueprint.initial().items()}
        for state in self._active.values():
            state.activate()

    def active(self, branch: str) -> State:
        """Return the active state object of a branch."""
        return self._active[branch]

    def ask(self, branch: str, state: str, operation: str) -> Answer:
        """Return the answer of a state object, active or not, to an operation.

        Args:
            branch: Name of the branch.
            state: Name of its state.
            operation: Name of the operation.
        """
        return self.objects[branch][state].ask(operation)

    def joint(self) -> dict[str, str]:
        """Return the joint state: branch to the name of its active state."""
        return {branch: state.name for branch, state in self._active.items()}

    def transition(self, targets: Mapping[str, str]) -> None:
        """Move all named branches in one step and check that each branch has one active state.

        Raises:
            KeyError: A target does not exist; nothing has moved.
            BlueprintError: A branch does not have exactly one active state; the joint state is invalid.
        """
        arriving = {branch: self.objects[branch][target] for branch, target in targets.items()}
        for branch, state in arriving.items():
            self._active[branch].deactivate()
            self._active[branch] = state
            state.activate()
        self.check_unique()

    def _check_answers(self, blueprint: Blueprint) -> None:
        for name, branch in blueprint.branches.items():
            for operation, spec in branch.operations.items():
                for state, instance in self.objects[name].items():
                    answer = instance.ask(operation)
                    if answer != spec if branch.valid_in(operation, state) else not isinstance(answer, Denial):
                        text = f"The state class {name} {state} and the blueprint disagree on {operation}."
                        raise BlueprintError(text, branch=name, state=state, operation=operation)

    def check_unique(self) -> None:
        """Raise `BlueprintError` unless every branch has exactly one active state."""
        # One comparison at every commit; only a mismatch is worth the loop that names its branch.
        if [state for state in self._all if state.active] == list(self._active.values()):
            return
        for branch, objects in self.objects.items():
            active = [name for name, state in objects.items() if state.active]
            if active != [self._active[branch].name]:
                raise BlueprintError(f"{branch} has {len(active)} active states: {active}", branch=branch)


def flags_of(blueprint: Blueprint, states: Mapping[str, str]) -> dict[str, bool]:
    """Return the flags that mirror the digits of the states. They are for display; nothing is decided by them.

    Args:
        blueprint: The workflow.
        states: Joint state: branch to state.
    """
    return {
        flag: digit == "1"
        for name, branch in blueprint.branches.items()
        for flag, digit in zip(branch.flags, states[name], strict=bool(branch.flags))
    }
