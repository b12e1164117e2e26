"""Everything one operation may do, as a decision tree over the states of branches, grown where it is needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.verify.encoding import Batch, Encoding, Rows
from pcmrs.fsm.verify.observed import Decision, decide


@dataclass(slots=True)
class _Split:
    """Asks for one digit; what follows from each of its values that has occurred."""

    position: int
    branches: dict[int, _Split | Decision] = field(default_factory=dict)


class Decisions:
    """The decisions of one operation.

    A closure looks at few branches, and which it looks at next depends on those it has seen: that is a decision
    tree. It is evaluated once for each of its leaves that occurs, however many joint states lead there.

    Args:
        blueprint: The workflow.
        other: The same with its branches in another order.
        encoding: Of its joint states.
        branch: The operation's branch.
        operation: Its name.
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
        """How the blueprint declares the operation."""
        return self._blueprint.branches[self.branch].operations[self.operation]

    def split(self, batch: Batch) -> Iterator[tuple[Decision, Rows]]:
        """Divide joint states by the decision that is taken there."""
        yield from self._below(self._root, batch, None)

    def _below(self, node: _Split, batch: Batch, rows: Rows | None) -> Iterator[tuple[Decision, Rows]]:
        for value, part in batch.split(node.position, rows):
            if not len(part):
                continue
            if value not in node.branches:
                self._grow(int(batch.codes[part[0]]))
            following = node.branches[value]
            if isinstance(following, Decision):
                yield following, part
            else:
                yield from self._below(following, batch, part)

    def _grow(self, code: int) -> None:
        """Add the decision that is taken in a joint state, and the questions that lead to it."""
        self._count()
        states = self._encoding.decoded(code)
        decision = decide((self._blueprint, self._other), states, self.branch, self.operation)
        self.known.append(decision)
        node = self._root
        digit = self._encoding.value(self.branch, states[self.branch])
        for asked in self._worth_asking(decision):
            following = node.branches.setdefault(digit, _Split(self._encoding.position[asked]))
            if isinstance(following, Decision):
                raise TypeError(f"the closure of {self.name} is not a function of the joint state")
            node, digit = following, self._encoding.value(asked, states[asked])
        node.branches[digit] = decision

    def _worth_asking(self, decision: Decision) -> Iterator[str]:
        """The branches that it depends on: its own is asked first anyway, and one with a single state never."""
        for name in decision.seen:
            if name != self.branch and self._encoding.sizes[self._encoding.position[name]] > 1:
                yield name
