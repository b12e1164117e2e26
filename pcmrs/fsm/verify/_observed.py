"""Joint states that note which branches are looked at."""

from __future__ import annotations

from collections.abc import Mapping

from pcmrs.fsm.blueprint import Blueprint


class DependencyObserver:
    """Source of joint states that notes which of their states are compared or hashed.

    Nothing else can make a decision depend on a state. The states that it gives out must not be used after the
    observation, as comparing them would be noted.

    Args:
        blueprint: The workflow.

    Attributes:
        states: The joint state under observation.
        seen: The branches that were looked at and their states, in this order.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.states: Mapping[str, str] = {}
        self.seen: dict[str, str] = {}
        self._observed = {
            name: {state: _ObservedState(state, name, self) for state in branch.states}
            for name, branch in blueprint.branches.items()
        }

    def observe(self, states: Mapping[str, str], first: str) -> tuple[dict[str, str], dict[str, str]]:
        """Begin an observation.

        Args:
            states: The joint state.
            first: Branch that counts as seen from the start.

        Returns:
            The joint state to look at, and `seen`.
        """
        self.states, self.seen = states, {first: states[first]}
        return {name: self._observed[name][state] for name, state in states.items()}, self.seen


class _ObservedState(str):
    """A state that notes when it is compared or hashed."""

    _branch: str
    _plain: str
    _observer: DependencyObserver

    def __new__(cls, state: str, branch: str, observer: DependencyObserver) -> _ObservedState:
        made = super().__new__(cls, state)
        made._plain, made._branch, made._observer = state, branch, observer
        return made

    def __eq__(self, other: object) -> bool:
        self._observer.seen.setdefault(self._branch, self._plain)
        return str.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        self._observer.seen.setdefault(self._branch, self._plain)
        return str.__ne__(self, other)

    def __hash__(self) -> int:
        self._observer.seen.setdefault(self._branch, self._plain)
        return str.__hash__(self)
