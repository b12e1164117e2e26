"""Decision about one operation: its possible results, and the states of branches that it depends on.

The branches that a closure depends on are found by observing which states it reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pcmrs.fsm.behaviour import Ruling, endings
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Change, Closure, close
from pcmrs.fsm.verify._cascades import Cascades
from pcmrs.fsm.verify._observed import DependencyObserver

LockSets = tuple[frozenset[str], frozenset[str]]
"""Branches locked for writing, and for reading."""


@dataclass(frozen=True, slots=True, eq=False)
class DecisionCase:
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
    locks: LockSets
    ordered: bool

    @property
    def accepted(self) -> bool:
        """The operation is accepted here."""
        return self.denied is None


class Decider:
    """Cache of the decisions about the operations of a workflow.

    Args:
        orders: The workflow, and copies with their branches in other orders, if order is to be checked.
    """

    def __init__(self, *orders: Blueprint) -> None:
        self._blueprint, *self._reordered = orders
        self._observer = DependencyObserver(self._blueprint)
        self._cascades = Cascades(self._observer, self._reordered)

    def decide(self, states: Mapping[str, str], branch: str, operation: str) -> DecisionCase:
        """Work out the closure of an operation in a joint state, and what it depends on.

        Args:
            states: The joint state.
            branch: Branch of the operation.
            operation: Any of its operations.
        """
        self._cascades.followed.clear()
        watched, seen = self._observer.observe(states, branch)
        answer = close(self._blueprint, watched, branch, operation, follow=self._cascades.follow)
        ordered, touched = False, {name for change in _changes(answer) for name in change.targets}
        if any(each.ordered for each in self._cascades.followed):
            others = [close(order, watched, branch, operation) for order in self._reordered]
            ordered = any(_result(other) != _result(answer) for other in others)
            touched |= {name for other in others for change in _changes(other) for name in change.targets}
        else:
            for each in self._cascades.followed:
                seen.update(each.also_seen)
        seen.update({name: states[name] for name in states if name in touched})
        # No observed state must leave this function: targets and names come from the blueprint.
        if not isinstance(answer, Closure):
            return DecisionCase(seen, answer.code, {}, frozenset(), frozenset(), (frozenset(), frozenset()), ordered)
        spec = self._blueprint.branches[branch].operations[operation]
        ends = {name: {} if change is None else change.targets for name, change in endings(spec, answer).items()}
        calls = frozenset(
            (effect.branch, effect.operation)
            for change in _changes(answer)
            for effect in change.effects
            if effect.kind == "signal"
        )
        return DecisionCase(seen, None, ends, frozenset(answer.outcomes), calls, (answer.writes, answer.reads), ordered)


def _changes(answer: Ruling) -> list[Change]:
    """Return everything that an answer may commit."""
    if not isinstance(answer, Closure):
        return []
    return [*answer.outcomes.values(), *(change for change in (answer.failure, answer.unknown) if change)]


def _result(answer: Ruling) -> object:
    if not isinstance(answer, Closure):
        return answer.code
    return [change.targets for change in _changes(answer)], sorted(answer.outcomes)
