"""The joint states that a workflow can reach, and every transition between them."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import msgspec
import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint, OperationSpec
from pcmrs.fsm.verify._encoding import MAX_COMBINATIONS, Batch, Codes, Encoding, Mask
from pcmrs.fsm.verify._forest import DecisionNumbers, Forest
from pcmrs.fsm.verify._relation import Edges, Relation
from pcmrs.fsm.verify._search import Progress, SearchLimitError, search
from pcmrs.fsm.verify._transition import Allowed, Paths, Transition
from pcmrs.fsm.verify.decision import Decider, DecisionCase, LockSets

MAX_DECISIONS = 10_000
"""Limit of evaluated closures; a common workflow needs hundreds, even with a million joint states."""

MAX_WORK = 1_000_000
"""Limit of branches and revocations in all evaluations together: in a large workflow, each evaluation is slow."""


@dataclass(frozen=True, slots=True)
class Operation:
    """An operation that may be asked for from outside.

    Attributes:
        branch: Its branch.
        operation: Its name in the branch.
        spec: Its declaration.
        known: The decisions about it that occur.
    """

    branch: str
    operation: str
    spec: OperationSpec
    known: list[DecisionCase] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Branch and operation, as users write it."""
        return f"{self.branch}.{self.operation}"


class StateSpace:
    """Reachable joint states of a workflow, and the transitions between them.

    Args:
        blueprint: The workflow, obeying the static rules.
        limit: Largest number of joint states.
        progress: Called regularly with the numbers of joint states that have been examined and that are known.

    Attributes:
        encoding: Encoding of the joint states.
        operations: Every operation that may be asked for from outside.
        reached: The joint states that can be reached.
        taken: Number of transitions between them: accepted commands, with each of their endings.

    Raises:
        SearchLimitError: There are more than `limit` joint states, or combinations than can be encoded or decided on.
    """

    def __init__(self, blueprint: Blueprint, limit: int, progress: Progress | None = None) -> None:
        self.blueprint = blueprint
        self.limit = limit
        self.encoding = Encoding({name: list(branch.states) for name, branch in blueprint.branches.items()})
        check_encodable(self.encoding)
        # A closure that depends on the order of the branches differs, as a rule, in the reverse order.
        other = msgspec.structs.replace(blueprint, branches=dict(reversed(blueprint.branches.items())))
        self._decider = Decider(blueprint, other)
        self.operations = [
            Operation(name, operation, spec)
            for name, branch in blueprint.branches.items()
            for operation, spec in branch.operations.items()
            if not spec.iio
        ]
        own = [self.encoding.position[operation.branch] for operation in self.operations]
        self._forest = Forest(self.encoding, own, self._decide)
        self.taken = 0
        self._left = min(MAX_DECISIONS, MAX_WORK // _size(blueprint))
        self._order: list[int] = []
        self._counts, self._shifts = array("q"), array("q")
        self._relation = Relation(*self._endings())
        initial = np.array([self.encoding.code(blueprint.initial())], dtype=np.int64)
        self.reached = search(self.encoding, initial, self._following, limit=limit, progress=progress)

    def decisions(self) -> Iterator[tuple[Operation, DecisionCase]]:
        """Return every operation with each decision about it that occurs."""
        for operation in self.operations:
            for decision in operation.known:
                yield operation, decision

    def decided(self, batch: Batch) -> DecisionNumbers:
        """Return the decision about each operation in each joint state of a batch.

        Args:
            batch: Joint states, which may have further digits.

        Returns:
            Numbers of the decisions, shape (operations, n).
        """
        return batch.cached("decided", self._forest.evaluate)

    @property
    def numbered(self) -> list[tuple[int, DecisionCase]]:
        """Decisions by their number, each with the number of its operation."""
        return self._forest.learned

    def relation(self, wanted: Callable[[Operation], bool], *, declared: bool = False) -> Relation:
        """Return some of the transitions.

        Args:
            wanted: Says of which operations.
            declared: Only those that end as declared.
        """
        chosen = np.array([wanted(operation) for operation in self.operations], dtype=np.bool_)
        decision, is_declared = self._taken
        operation = np.array([number for number, _ in self.numbered], dtype=np.int64)
        mask = chosen[operation[decision]] & (is_declared | (not declared))
        return Relation(np.bincount(decision[mask], minlength=len(self.numbered)), self._endings()[1][mask])

    @cached_property
    def _taken(self) -> tuple[NDArray[np.int64], Mask]:
        """Number of the decision of each transition, and a mask of those that end as declared."""
        declared = [name in decision.declared for _, decision in self.numbered for name in decision.endings]
        counts = self._endings()[0]
        return np.repeat(np.arange(len(counts)), counts), np.array(declared, dtype=np.bool_)

    @cached_property
    def kinds(self) -> tuple[list[tuple[Operation, LockSets]], NDArray[np.int64]]:
        """Operations with the locks that each may take, and which of them each decision means; -1 if it is denied."""
        found: dict[tuple[int, LockSets], int] = {}
        of = [
            found.setdefault((number, decision.locks), len(found)) if decision.accepted else -1
            for number, decision in self.numbered
        ]
        return [(self.operations[number], locks) for number, locks in found], np.array(of, dtype=np.int64)

    @cached_property
    def all(self) -> Relation:
        """All transitions."""
        return Relation(*self._endings())

    @cached_property
    def declared(self) -> Relation:
        """Transitions that end as declared: no fault or doubt is involved."""
        return self.relation(lambda _: True, declared=True)

    @cached_property
    def intended(self) -> Relation:
        """Transitions that a user may ask for and that end as declared."""
        return self.relation(lambda operation: not operation.spec.event, declared=True)

    def leaving(self, relation: Relation) -> Callable[[Batch], Edges]:
        """Return a function that returns the transitions of a relation from the joint states in a batch."""
        return lambda batch: relation.edges(batch.codes, self.decided(batch))

    def following(self, relation: Relation) -> Callable[[Batch], Codes]:
        """Return a function that returns the codes to which a relation leads from the joint states in a batch."""
        return lambda batch: relation.edges(batch.codes, self.decided(batch))[1]

    def transitions(self) -> Iterator[tuple[Operation, Transition]]:
        """Return every transition that can be taken, with its operation."""
        for operation, decision in (self.numbered[number] for number in self._order):
            for ending in decision.endings:
                yield self.operations[operation], self._transition(self.operations[operation], decision, ending)

    def path_to(self, code: int) -> tuple[str, ...]:
        """Return the commands of a shortest path to a joint state."""
        return self._paths.path_to(code)

    def nearest(self, decision: DecisionCase) -> int:
        """Return one of the nearest joint states where the decision is taken."""
        taken = {branch: [state] for branch, state in decision.seen.items()}
        found = self.reached.first(lambda batch: batch.matching(taken))
        if found is None:
            raise LookupError("a known decision is taken in no joint state")
        return found

    @cached_property
    def _paths(self) -> Paths:
        return Paths(self.encoding, self.reached.levels, [transition for _, transition in self.transitions()])

    def _decide(self, number: int, code: int) -> DecisionCase:
        self._left -= 1
        if self._left < 0:
            text = "The operations depend on too many combinations of the states of several branches: "
            raise SearchLimitError(f"{text}reduce the states, or let commands touch fewer branches.")
        operation = self.operations[number]
        decision = self._decider.decide(self.encoding.decoded(code), operation.branch, operation.operation)
        self._counts.append(len(decision.endings))
        self._shifts.extend(self._shift(decision.seen, targets) for targets in decision.endings.values())
        return decision

    def _shift(self, before: dict[str, str], after: dict[str, str]) -> int:
        """Return the number that the change of some branches adds to a code."""
        value, weights, position = self.encoding.value, self.encoding.weights, self.encoding.position
        moved = (name for name, state in after.items() if state != before[name])
        return sum((value(name, after[name]) - value(name, before[name])) * weights[position[name]] for name in moved)

    def _following(self, batch: Batch) -> Codes:
        decisions = self.decided(batch)
        new = range(len(self._order), len(self.numbered))
        if new:
            # Findings name the first decision of a kind: the order must not depend on how the trees have grown.
            self._order += sorted(new, key=lambda number: (self.numbered[number][0], self._forest.paths[number]))
            for operation, decision in (self.numbered[number] for number in self._order[new.start :]):
                self.operations[operation].known.append(decision)
            self._relation = Relation(*self._endings())
        self.taken += int(self._relation.counts[decisions].sum())
        return self._relation.edges(batch.codes, decisions)[1]

    def _endings(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the number of endings of each decision, and the shift of each ending."""
        return np.array(self._counts, dtype=np.int64), np.array(self._shifts, dtype=np.int64)

    def _transition(self, operation: Operation, decision: DecisionCase, ending: str) -> Transition:
        targets = digits(self.encoding, decision.endings[ending])
        return Transition.of(self.encoding, command(operation, ending), guard(self.encoding, decision), targets)


def _size(blueprint: Blueprint) -> int:
    return sum(1 + len(branch.revocations) for branch in blueprint.branches.values())


def command(operation: Operation, ending: str) -> str:
    """Return an operation and its ending, as users write it.

    Args:
        operation: The operation.
        ending: Name of its ending.
    """
    return operation.name + (f":{ending}" if ending != START_OUTCOME else "")


def check_encodable(encoding: Encoding) -> None:
    """Refuse an encoding with more combinations than a 64-bit integer can tell apart.

    Raises:
        SearchLimitError: There are more than `MAX_COMBINATIONS`.
    """
    if encoding.combinations > MAX_COMBINATIONS:
        text = "The states of the branches and what runs in them have more than 2^62 combinations: "
        raise SearchLimitError(f"{text}reduce the branches, the states, or the operations that properties watch.")


def guard(encoding: Encoding, decision: DecisionCase) -> Allowed:
    """Return the digits that a decision depends on, with their values.

    Args:
        encoding: Encoding of the joint states.
        decision: The decision.
    """
    return {digit: (value,) for digit, value in digits(encoding, decision.seen).items()}


def digits(encoding: Encoding, states: dict[str, str]) -> dict[int, int]:
    """Return the states of branches as digits; a branch with a single state is left out.

    Args:
        encoding: Encoding of the joint states.
        states: Branch to state.
    """
    found = {encoding.position[branch]: encoding.value(branch, state) for branch, state in states.items()}
    return {digit: value for digit, value in found.items() if encoding.sizes[digit] > 1}
