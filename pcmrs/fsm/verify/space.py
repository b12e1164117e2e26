"""The joint states that a workflow can reach, and every way from one to another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from pcmrs.fsm.behaviour import endings
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify.decisions import Decisions
from pcmrs.fsm.verify.encoding import MAX_COMBINATIONS, Batch, Codes, Encoding, Rows
from pcmrs.fsm.verify.observed import Decision
from pcmrs.fsm.verify.search import Progress, TooManyError, search
from pcmrs.fsm.verify.transition import Transition

MAX_DECISIONS = 10_000
"""So many closures are worked out; a common workflow has hundreds, even with a million joint states."""

MAX_WORK = 1_000_000
"""Fewer are worked out of a workflow so large that each takes long: this many branches and revocations in all."""


class Space:
    """What a workflow can do.

    Args:
        blueprint: The workflow, obeying the static rules.
        limit: How many joint states it may have.
        progress: Told now and then how many joint states have been looked at, and how many are known.

    Attributes:
        encoding: Of joint states.
        operations: The decisions of everything that may be asked for from outside.
        reached: The joint states that can be reached.
        taken: How many transitions there are between them: commands that are accepted, with each of their endings.

    Raises:
        TooManyError: There are more than `limit` joint states, or more combinations than can be encoded or decided on.
    """

    def __init__(self, blueprint: Blueprint, limit: int, progress: Progress | None = None) -> None:
        self.blueprint = blueprint
        self.limit = limit
        self.encoding = Encoding({name: list(branch.states) for name, branch in blueprint.branches.items()})
        encodable(self.encoding)
        other = msgspec.structs.replace(blueprint, branches=dict(reversed(blueprint.branches.items())))
        self.operations = [
            Decisions(blueprint, other, self.encoding, name, operation, self._count)
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

    def decisions(self) -> Iterator[tuple[Decisions, Decision]]:
        """Every operation with each decision about it that occurs."""
        for operation in self.operations:
            for decision in operation.known:
                yield operation, decision

    def way_to(self, code: int) -> tuple[str, ...]:
        """The commands of a shortest way to a joint state."""
        return self.reached.way_to(code, self.transitions)

    def nearest(self, decision: Decision) -> int:
        """One of the nearest joint states where the decision is taken."""
        taken = {branch: [state] for branch, state in decision.seen.items()}
        found = self.reached.first(lambda batch: batch.matching(taken))
        if found is None:
            raise LookupError("a decision is known that is taken nowhere")
        return found

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            text = "The operations depend on too many combinations of the states of their own and other branches: "
            raise TooManyError(f"{text}make it fewer states, or let commands touch fewer branches.")

    def _following(self, batch: Batch) -> Iterator[Codes]:
        for operation in self.operations:
            for decision, rows in operation.split(batch):
                yield from self._after(operation, decision, batch, rows)

    def _after(self, operation: Decisions, decision: Decision, batch: Batch, rows: Rows) -> Iterator[Codes]:
        if decision not in self._transitions:
            self._transitions[decision] = list(self._transitions_of(operation, decision))
        self.taken += len(rows) * len(self._transitions[decision])
        for transition in self._transitions[decision]:
            if transition.shift:
                yield batch.codes[rows] + transition.shift

    def _transitions_of(self, operation: Decisions, decision: Decision) -> Iterator[Transition]:
        where, asked = guard(self.encoding, decision), (operation.branch, operation.operation)
        for ending in endings_of(operation, decision):
            intended = ending.declared and not operation.spec.event
            targets = digits(self.encoding, ending.targets)
            yield Transition.of(self.encoding, ending.command, asked, intended, where, targets)


def _size(blueprint: Blueprint) -> int:
    return sum(1 + len(branch.revocations) for branch in blueprint.branches.values())


@dataclass(frozen=True, slots=True)
class Ending:
    """One way in which an operation may end.

    Attributes:
        command: How it is written, ``branch.operation`` or ``branch.operation:outcome``.
        declared: It ends as the blueprint wants it, not in a failure or in doubt.
        targets: The branches that it changes, and to what.
    """

    command: str
    declared: bool
    targets: dict[str, str]


def endings_of(operation: Decisions, decision: Decision) -> Iterator[Ending]:
    """Every way the operation may end where the decision is taken; none where it is denied."""
    if isinstance(decision.answer, Closure):
        for name, change in endings(operation.spec, decision.answer).items():
            command = operation.name + (f":{name}" if name != START_OUTCOME else "")
            yield Ending(command, name in decision.answer.outcomes, {} if change is None else change.targets)


def encodable(encoding: Encoding) -> None:
    """Raise `TooManyError` where there are more combinations than can be told apart."""
    if encoding.combinations > MAX_COMBINATIONS:
        text = "The states of the branches and what runs in them have more than 2^62 combinations: "
        raise TooManyError(f"{text}make it fewer branches or states, or properties that watch fewer operations.")


def guard(encoding: Encoding, decision: Decision) -> dict[int, tuple[int, ...]]:
    """The digits that a decision depends on."""
    return {digit: (value,) for digit, value in digits(encoding, decision.seen).items()}


def digits(encoding: Encoding, states: dict[str, str]) -> dict[int, int]:
    """States of branches as digits; one that has a single state says nothing."""
    found = {encoding.position[branch]: encoding.value(branch, state) for branch, state in states.items()}
    return {digit: value for digit, value in found.items() if encoding.sizes[digit] > 1}
