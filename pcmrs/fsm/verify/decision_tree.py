"""The possible results of one operation, as a decision tree over the states of branches that grows on demand.

The branches that a closure depends on are found by observing which states it reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from pcmrs.fsm.behaviour import Ruling
from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Closure, close
from pcmrs.fsm.verify.encoding import Batch, Encoding, Rows


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Result of an operation wherever the branches that it depends on have these states.

    Attributes:
        seen: The branches it depends on and their states, its own first, then in the order of reading.
        answer: The closure, or why it is denied. In its joint states only the touched branches are valid.
        ordered: Another order of the branches in the file would give another result.
    """

    seen: dict[str, str]
    answer: Ruling
    ordered: bool


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
    found = [close(each, watched, branch, operation) for each in orders]
    touched = {name for each in found for name in _touched(each)}
    seen |= {name: states[name] for name in states if name in touched and name not in seen}
    # Once more with plain strings: the observed ones must not leave this function.
    plain = close(orders[0], states, branch, operation)
    return Decision(seen, plain, any(_result(each) != _result(found[0]) for each in found[1:]))


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


def changes(closure: Closure) -> list[Change]:
    """Return everything that a closure may commit."""
    return [*closure.outcomes.values(), *(change for change in (closure.failure, closure.unknown) if change)]


def _touched(found: Ruling) -> list[str]:
    if not isinstance(found, Closure):
        return []
    return [effect.branch for change in changes(found) for effect in change.effects]


def _result(found: Ruling) -> object:
    if not isinstance(found, Closure):
        return found.code
    return [dict(sorted(change.targets.items())) for change in changes(found)], sorted(found.outcomes)


@dataclass(slots=True)
class _Split:
    """A question for one digit, and the node below each of its values that has occurred."""

    position: int
    branches: dict[int, _Split | Decision] = field(default_factory=dict)


class DecisionTree:
    """The decisions of one operation.

    A closure reads few branches, and which it reads next depends on those it has read: that is a decision
    tree. It is evaluated once for each of its leaves that occurs, however many joint states lead there.

    Args:
        blueprint: The workflow.
        other: The workflow with its branches in another order.
        encoding: Encoding of its joint states.
        branch: Branch of the operation.
        operation: Name of the operation.
        count: Called before each evaluation; may refuse by raising.

    Attributes:
        known: The decisions that have occurred.
    """

    def __init__(
        self,
        blueprint: Blueprint,
        other: Blueprint,
        encoding: Encoding,
        branch: str,
        operation: str,
        count: Callable[[], None],
    ) -> None:
        self.branch = branch
        self.operation = operation
        self.known: list[Decision] = []
        self._blueprint = blueprint
        self._other = other
        self._encoding = encoding
        self._count = count
        self._root = _Split(encoding.position[branch])

    @property
    def name(self) -> str:
        """Branch and operation, as users write it."""
        return f"{self.branch}.{self.operation}"

    @property
    def spec(self) -> OperationSpec:
        """Declaration of the operation."""
        return self._blueprint.branches[self.branch].operations[self.operation]

    def split(self, batch: Batch) -> Iterator[tuple[Decision, Rows]]:
        """Divide joint states by the decision that is taken there."""
        yield from self._below(self._root, batch, None)

    def _below(self, node: _Split, batch: Batch, rows: Rows | None) -> Iterator[tuple[Decision, Rows]]:
        for value, part in batch.split(node.position, rows):
            if not len(part):
                continue
            if value not in node.branches:
                self._learn(int(batch.codes[part[0]]))
            following = node.branches[value]
            if isinstance(following, Decision):
                yield following, part
            else:
                yield from self._below(following, batch, part)

    def _learn(self, code: int) -> None:
        """Add the decision that is taken in a joint state, and the questions that lead to it."""
        self._count()
        states = self._encoding.decoded(code)
        decision = decide((self._blueprint, self._other), states, self.branch, self.operation)
        self.known.append(decision)
        node = self._root
        digit = self._encoding.value(self.branch, states[self.branch])
        for name in self._relevant_branches(decision):
            following = node.branches.setdefault(digit, _Split(self._encoding.position[name]))
            if isinstance(following, Decision):
                raise TypeError(f"the closure of {self.name} is not a function of the joint state")
            node, digit = following, self._encoding.value(name, states[name])
        node.branches[digit] = decision

    def _relevant_branches(self, decision: Decision) -> Iterator[str]:
        """Return the branches that a decision depends on, except its own, asked first, and those of a single state."""
        for name in decision.seen:
            if name != self.branch and self._encoding.sizes[self._encoding.position[name]] > 1:
                yield name
