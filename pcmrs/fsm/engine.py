"""The synchronous core: which operations a joint state accepts, and where they lead. No journal, steps or locks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pcmrs.fsm._branch import StateSet
from pcmrs.fsm.behaviour import endings
from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Closure, Denial, close


@dataclass(slots=True)
class _Situation:
    """A joint state, and the answers worked out for it, which depend on nothing else."""

    states: dict[str, str]
    answers: dict[tuple[str, str], Closure | Denial] = field(default_factory=dict)
    allowed: dict[str, list[str]] = field(default_factory=dict)


class Engine:
    """One workflow and the joint state it is in.

    The active state object of a branch is asked for each operation, and the closure of what it allows is worked
    out once for each joint state, since it depends on nothing else.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.blueprint = blueprint
        self._states = StateSet(blueprint)
        self._situations: dict[tuple[str, ...], _Situation] = {}
        self._here = self._situation(self._states.joint())

    def joint(self) -> dict[str, str]:
        """Return the joint state: branch to state."""
        return self._here.states.copy()

    def ask(self, branch: str, operation: str, *, states: Mapping[str, str] | None = None) -> Closure | Denial:
        """Return what the operation would change, or why it is not allowed.

        Args:
            branch: Branch of the operation.
            operation: Any of its operations.
            states: A joint state; the present one by default.

        Raises:
            KeyError: There is no such branch or operation.
        """
        return self._ask(self._here if states is None else self._situation(states), branch, operation)

    def allowed(self, branch: str, states: Mapping[str, str] | None = None) -> list[str]:
        """Return the operations of a branch that users may ask for and would not be denied, in the blueprint's order.

        Args:
            branch: Name of the branch.
            states: A joint state; the present one by default.
        """
        situation = self._here if states is None else self._situation(states)
        if branch not in situation.allowed:
            operations = self.blueprint.branches[branch].operations
            requestable = (name for name, spec in operations.items() if not spec.iio and not spec.event)
            able = [name for name in requestable if isinstance(self._ask(situation, branch, name), Closure)]
            situation.allowed[branch] = able
        return situation.allowed[branch].copy()

    def perform(self, branch: str, operation: str, outcome: str | None = None) -> Change | Denial:
        """Perform an operation at once.

        Args:
            branch: Branch of the operation.
            operation: One of its operations.
            outcome: A declared outcome, ``failed`` or ``unknown``; may be left out where one outcome is possible.

        Returns:
            The change, or why nothing changed. An operation that fails and stays where it is changes nothing.

        Raises:
            KeyError: There is no such branch, operation or outcome here.
        """
        closure = self.ask(branch, operation)
        if isinstance(closure, Denial):
            return closure
        change = self._ending(closure, self.blueprint.branches[branch].operations[operation], outcome)
        self.place(change.targets)
        return change

    def place(self, states: Mapping[str, str]) -> None:
        """Put the named branches into states, all together.

        Raises:
            KeyError: A branch or state does not exist; nothing has moved.
        """
        self._states.transition(states)
        self._here = self._situation(self._states.joint())

    def _ending(self, closure: Closure, spec: OperationSpec, outcome: str | None) -> Change:
        if outcome is None and len(closure.outcomes) == 1:
            return next(iter(closure.outcomes.values()))
        return endings(spec, closure)[outcome or ""] or Change(self.joint(), ())

    def _ask(self, situation: _Situation, branch: str, operation: str) -> Closure | Denial:
        """Return the answer of the state objects. They also decide on each operation that a cascade calls."""
        # Nearly every call is a hit, which `try` serves fastest.
        try:
            return situation.answers[branch, operation]
        except KeyError:
            found = close(self.blueprint, situation.states, branch, operation, self._states.ask)
            return situation.answers.setdefault((branch, operation), found)

    def _situation(self, states: Mapping[str, str]) -> _Situation:
        key = tuple(map(states.__getitem__, self.blueprint.branches))
        if key not in self._situations:
            self._situations[key] = _Situation(dict(zip(self.blueprint.branches, key, strict=True)))
        return self._situations[key]
