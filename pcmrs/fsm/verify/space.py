"""The joint states that a workflow can reach, and every transition between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from pcmrs.fsm.behaviour import endings
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify.decision_tree import Decision, DecisionTree
from pcmrs.fsm.verify.encoding import MAX_COMBINATIONS, Batch, Codes, Encoding, Rows
from pcmrs.fsm.verify.search import Progress, SearchLimitError, search
from pcmrs.fsm.verify.transition import Transition

MAX_DECISIONS = 10_000
"""Limit of evaluated closures; a common workflow needs hundreds, even with a million joint states."""

MAX_WORK = 1_000_000
"""Limit of branches and revocations in all evaluations together: in a large workflow, each evaluation is slow."""


class Space:
    """Reachable joint states of a workflow, and the transitions between them.

    Args:
        blueprint: The workflow, obeying the static rules.
        limit: Largest number of joint states.
        progress: Called regularly with the numbers of joint states that have been examined and that are known.

    Attributes:
        encoding: Encoding of the joint states.
        operations: Decision tree of every operation that may be asked for from outside.
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
        self.operations = [
            DecisionTree(blueprint, other, self.encoding, name, operation, self._count)
            for name, branch in blueprint.branches.items()
            for operation, spec in branch.operations.items()
            if not spec.iio
        ]
        self.taken = 0
        self._left = min(MAX_DECISIONS, MAX_WORK // _size(blueprint))
        self._transitions: dict[Decision, list[Transition]] = {}
        initial = np.array([self.encoding.code(blueprint.initial())], dtype=np.int64)
        self.reached = search(self.encoding, initial, self._following, limit=limit, progress=progress)

    @property
    def transitions(self) -> list[Transition]:
        """Every transition that can be taken."""
        return [transition for found in self._transitions.values() for transition in found]

    def transitions_after(self, decision: Decision) -> list[Transition]:
        """Return the transitions that can be taken where a decision is taken."""
        return self._transitions[decision]

    def decisions(self) -> Iterator[tuple[DecisionTree, Decision]]:
        """Return every operation with each decision about it that occurs."""
        for operation in self.operations:
            for decision in operation.known:
                yield operation, decision

    def path_to(self, code: int) -> tuple[str, ...]:
        """Return the commands of a shortest path to a joint state."""
        return self.reached.path_to(code, self.transitions)

    def nearest(self, decision: Decision) -> int:
        """Return one of the nearest joint states where the decision is taken."""
        taken = {branch: [state] for branch, state in decision.seen.items()}
        found = self.reached.first(lambda batch: batch.matching(taken))
        if found is None:
            raise LookupError("a known decision is taken in no joint state")
        return found

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            text = "The operations depend on too many combinations of the states of several branches: "
            raise SearchLimitError(f"{text}reduce the states, or let commands touch fewer branches.")

    def _following(self, batch: Batch) -> Iterator[Codes]:
        for operation in self.operations:
            for decision, rows in operation.split(batch):
                yield from self._after(operation, decision, batch, rows)

    def _after(self, operation: DecisionTree, decision: Decision, batch: Batch, rows: Rows) -> Iterator[Codes]:
        if decision not in self._transitions:
            self._transitions[decision] = list(self._transitions_of(operation, decision))
        self.taken += len(rows) * len(self._transitions[decision])
        for transition in self._transitions[decision]:
            if transition.shift:
                yield batch.codes[rows] + transition.shift

    def _transitions_of(self, operation: DecisionTree, decision: Decision) -> Iterator[Transition]:
        where, requested = guard(self.encoding, decision), (operation.branch, operation.operation)
        for ending in endings_of(operation, decision):
            intended = ending.declared and not operation.spec.event
            targets = digits(self.encoding, ending.targets)
            yield Transition.of(self.encoding, ending.command, requested, intended, where, targets)


def _size(blueprint: Blueprint) -> int:
    return sum(1 + len(branch.revocations) for branch in blueprint.branches.values())


@dataclass(frozen=True, slots=True)
class Ending:
    """One way in which an operation may end.

    Attributes:
        command: ``branch.operation`` or ``branch.operation:outcome``.
        declared: It ends as the blueprint declares, not in a failure or in doubt.
        targets: The branches that it changes, and their new states.
    """

    command: str
    declared: bool
    targets: dict[str, str]


def endings_of(operation: DecisionTree, decision: Decision) -> Iterator[Ending]:
    """Return every way the operation may end where the decision is taken; none where it is denied.

    Args:
        operation: The operation.
        decision: One of its decisions.
    """
    if isinstance(decision.answer, Closure):
        for name, change in endings(operation.spec, decision.answer).items():
            command = operation.name + (f":{name}" if name != START_OUTCOME else "")
            yield Ending(command, name in decision.answer.outcomes, {} if change is None else change.targets)


def check_encodable(encoding: Encoding) -> None:
    """Refuse an encoding with more combinations than a 64-bit integer can tell apart.

    Raises:
        SearchLimitError: There are more than `MAX_COMBINATIONS`.
    """
    if encoding.combinations > MAX_COMBINATIONS:
        text = "The states of the branches and what runs in them have more than 2^62 combinations: "
        raise SearchLimitError(f"{text}reduce the branches, the states, or the operations that properties watch.")


def guard(encoding: Encoding, decision: Decision) -> dict[int, tuple[int, ...]]:
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
