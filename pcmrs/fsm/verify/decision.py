"""Decision about one operation: its possible results, and the states of branches that it depends on.

The branches that a closure depends on are found by observing which states it reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pcmrs.fsm.behaviour import Ruling, endings
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Change, Closure, close

Locks = tuple[frozenset[str], frozenset[str]]
"""Branches locked for writing, and for reading."""


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Result of an operation wherever the branches that it depends on have these states.

    Attributes:
        seen: The branches it depends on and their states, its own first, then in the order of reading.
        denied: Code of the denial; None where the operation is accepted.
        endings: Every way in which it may end, with the branches that it touches then and their new states.
        declared: Those endings that the blueprint declares: neither a failure nor in doubt.
        calls: Operations of parents that it may call: branch and operation.
        locks: Locks that it holds while it runs.
        ordered: Another order of the branches in the file would give another result.
    """

    seen: dict[str, str]
    denied: str | None
    endings: dict[str, dict[str, str]]
    declared: frozenset[str]
    calls: frozenset[tuple[str, str]]
    locks: Locks
    ordered: bool

    @property
    def accepted(self) -> bool:
        """The operation is accepted here."""
        return self.denied is None


def decide(orders: Sequence[Blueprint], states: Mapping[str, str], branch: str, operation: str) -> Decision:
    """Work out the closure of an operation in a joint state, and what it depends on.

    Args:
        orders: The workflow, and copies with their branches in other orders, if order is to be checked.
        states: The joint state.
        branch: Branch of the operation.
        operation: Any of its operations.
    """
    seen = {branch: states[branch]}
    watched = {name: state if name == branch else _ObservedState(state, name, seen) for name, state in states.items()}
    answer = close(orders[0], watched, branch, operation)
    others = [close(each, watched, branch, operation) for each in orders[1:]] if _has_sequel(answer) else []
    touched = {effect.branch for each in (answer, *others) for change in _changes(each) for effect in change.effects}
    seen |= {name: states[name] for name in states if name in touched and name not in seen}
    ordered = any(_result(each) != _result(answer) for each in others)
    # No observed state must leave this function: targets and names come from the blueprint.
    if not isinstance(answer, Closure):
        return Decision(seen, answer.code, {}, frozenset(), frozenset(), (frozenset(), frozenset()), ordered)
    spec = orders[0].branches[branch].operations[operation]
    ends = {name: {} if change is None else _targets(change) for name, change in endings(spec, answer).items()}
    signals = (effect for change in _changes(answer) for effect in change.effects if effect.kind == "signal")
    calls = frozenset((effect.branch, effect.operation) for effect in signals)
    locks = (answer.writes, answer.reads)
    return Decision(seen, None, ends, frozenset(answer.outcomes), calls, locks, ordered)


class _ObservedState(str):
    """A state that notes when it is compared or hashed: nothing else can make a decision depend on it."""

    _branch: str
    _seen: dict[str, str]

    def __new__(cls, state: str, branch: str, seen: dict[str, str]) -> _ObservedState:
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


def _has_sequel(answer: Ruling) -> bool:
    """Return true unless nothing was re-initiated or revoked: only that is done in the order of the branches."""
    if not isinstance(answer, Closure):
        return True
    return any(effect.kind in ("reinit", "revoke") for change in _changes(answer) for effect in change.effects)


def _changes(answer: Ruling) -> list[Change]:
    """Return everything that an answer may commit."""
    if not isinstance(answer, Closure):
        return []
    return [*answer.outcomes.values(), *(change for change in (answer.failure, answer.unknown) if change)]


def _targets(change: Change) -> dict[str, str]:
    return {effect.branch: change.states[effect.branch] for effect in change.effects}


def _result(answer: Ruling) -> object:
    if not isinstance(answer, Closure):
        return answer.code
    return [_targets(change) for change in _changes(answer)], sorted(answer.outcomes)
