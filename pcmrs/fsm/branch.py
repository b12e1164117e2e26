"""State Branches as classes: the base class refuses every operation, a state overrides the valid ones.

The classes are made from a blueprint, one singleton object per state class and loaded blueprint. The
dispatcher asks the active object of a branch; which class it is of decides what is allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.closure import Denial

Answer = OperationSpec | Denial
"""What a state says to an operation: how to perform it, or why not."""


class State:
    """Root of all branch and state classes.

    Attributes:
        branch: Name of the State Branch.
        name: Digits or name of the state; empty on a branch's base class.
    """

    branch: ClassVar[str] = ""
    name: ClassVar[str] = ""
    spec: ClassVar[BranchSpec]

    def __init__(self) -> None:
        self.active = False

    def activate(self) -> None:
        """Makes this the state its branch is in."""
        self.active = True

    def deactivate(self) -> None:
        """Leaves this state."""
        self.active = False

    def ask(self, operation: str) -> Answer:
        """Calls the operation's method on this object: the state's own, or the branch's refusal."""
        method: Callable[[], Answer] = getattr(self, operation)
        return method()

    def allowed(self) -> list[str]:
        """Operations a user may ask for in this state, in the blueprint's order."""
        overridden = vars(type(self))
        return [n for n, spec in self.spec.operations.items() if n in overridden and not spec.iio and not spec.event]


def _invalid(operation: str) -> Callable[[State], Answer]:
    def refuse(self: State) -> Answer:
        text = f"{self.branch} is in {self.name} ({self.spec.states[self.name]}), which does not allow {operation}."
        return Denial("invalid_in_state", text, {"branch": self.branch, "state": self.name, "operation": operation})

    refuse.__doc__ = f"{operation} is not valid in this state."
    return refuse


def _valid(operation: str, spec: OperationSpec) -> Callable[[State], Answer]:
    def allow(_self: State) -> Answer:
        return spec

    allow.__doc__ = f"{operation} is valid here."
    return allow


def make_states(branch: str, spec: BranchSpec) -> dict[str, State]:
    """Makes the base class of a branch, a derived class per state, and their singleton objects.

    Returns:
        State name to its object, all inactive.
    """
    title = branch.title().replace("_", "")
    refusals = {name: _invalid(name) for name in spec.operations}
    base = type(title, (State,), {"branch": branch, "spec": spec, "__doc__": spec.title, **refusals})
    objects: dict[str, State] = {}
    for state, meaning in spec.states.items():
        valid = {n: _valid(n, operation) for n, operation in spec.operations.items() if spec.valid_in(n, state)}
        derived = type(f"{title}{state.title()}", (base,), {"name": state, "__doc__": meaning, **valid})
        objects[state] = derived()
    return objects


class StateSet:
    """The singleton state objects of all branches, exactly one of each branch active.

    Args:
        blueprint: The loaded workflow; all branches start in their starting state.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.objects = {name: make_states(name, spec) for name, spec in blueprint.branches.items()}
        self._active = {name: self.objects[name][spec.start] for name, spec in blueprint.branches.items()}
        for state in self._active.values():
            state.activate()

    def active(self, branch: str) -> State:
        """The active state object of a branch."""
        return self._active[branch]

    def joint(self) -> dict[str, str]:
        """The joint state: branch to the name of its active state."""
        return {branch: state.name for branch, state in self._active.items()}

    def transition(self, targets: Mapping[str, str]) -> None:
        """Moves all named branches in one step and checks that each branch has one active state.

        Raises:
            KeyError: A target does not exist; nothing has moved.
            BlueprintError: A branch has not exactly one active state; nothing may be trusted any more.
        """
        arriving = {branch: self.objects[branch][target] for branch, target in targets.items()}
        for branch, state in arriving.items():
            self._active[branch].deactivate()
            self._active[branch] = state
            state.activate()
        self.check_unique()

    def check_unique(self) -> None:
        """Raises `BlueprintError` unless every branch has exactly one active state."""
        for branch, objects in self.objects.items():
            active = [name for name, state in objects.items() if state.active]
            if active != [self._active[branch].name]:
                raise BlueprintError(f"{branch} has {len(active)} active states: {active}", branch=branch)


def flags_of(blueprint: Blueprint, states: Mapping[str, str]) -> dict[str, bool]:
    """The flags that mirror the digits of the states, for display; nothing is decided by them."""
    return {
        flag: digit == "1"
        for name, branch in blueprint.branches.items()
        for flag, digit in zip(branch.flags, states[name], strict=bool(branch.flags))
    }
