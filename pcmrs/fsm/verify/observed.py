"""Which branches a closure depends on, found by watching it look at their states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pcmrs.fsm.behaviour import Ruling
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Change, Closure, close


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """What an operation may do wherever the branches it depends on are as they were here.

    Attributes:
        seen: The branches it depends on and their states, its own first, then in the order of looking at them.
        answer: The closure, or why it is denied. Of the joint states in it only the branches touched count.
        ordered: Another order of the branches in the file would give something else.
    """

    seen: dict[str, str]
    answer: Ruling
    ordered: bool


def decide(orders: Sequence[Blueprint], states: Mapping[str, str], branch: str, operation: str) -> Decision:
    """Work out the closure of an operation in a joint state, and what it depends on.

    Args:
        orders: The workflow, and the same with its branches in other orders, where that is of interest.
        states: The joint state.
        branch: The branch asked.
        operation: Any of its operations.
    """
    seen = {branch: states[branch]}
    watched = {name: state if name == branch else _Watched(state, name, seen) for name, state in states.items()}
    found = [close(each, watched, branch, operation) for each in orders]
    touched = {name for each in found for name in _touched(each)}
    seen |= {name: states[name] for name in states if name in touched and name not in seen}
    plain = close(orders[0], states, branch, operation)
    return Decision(seen, plain, any(_result(each) != _result(found[0]) for each in found[1:]))


class _Watched(str):
    """A state that notes when it is compared or looked up: nothing else can make a decision depend on it."""

    _branch: str
    _seen: dict[str, str]

    def __new__(cls, state: str, branch: str, seen: dict[str, str]) -> _Watched:
        made = super().__new__(cls, state)
        made._branch, made._seen = branch, seen
        return made

    def __eq__(self, other: object) -> bool:
        self._seen.setdefault(self._branch, str(self))
        return str.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        self._seen.setdefault(self._branch, str(self))
        return str.__hash__(self)


def changes(closure: Closure) -> list[Change]:
    """Everything that a closure may commit."""
    return [*closure.outcomes.values(), *(change for change in (closure.failure, closure.unknown) if change)]


def _touched(found: Ruling) -> list[str]:
    if not isinstance(found, Closure):
        return []
    return [effect.branch for change in changes(found) for effect in change.effects]


def _result(found: Ruling) -> object:
    if not isinstance(found, Closure):
        return found.code
    return [dict(sorted(change.targets.items())) for change in changes(found)], sorted(found.outcomes)
