"""Joint states together with operations that are running in them: what can happen while something runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.behaviour import line_of
from pcmrs.fsm.blueprint import Condition
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify.decisions import Decisions
from pcmrs.fsm.verify.encoding import Batch, Encoding
from pcmrs.fsm.verify.observed import Decision
from pcmrs.fsm.verify.search import Reached, TooManyError, search
from pcmrs.fsm.verify.space import Space, digits, endings_of, guard
from pcmrs.fsm.verify.transition import Transition, by_guard, successors

Locks = tuple[frozenset[str], frozenset[str]]
"""Branches locked for writing, and for reading."""

MOMENTS_PER_STATE = 8
"""So many times the limit of joint states may there be moments."""

STARTED = "started"
"""In place of an outcome in a command: it began, and how it ends comes later or is left open."""

STOP = "stop"
"""What conditions call Stop."""


class Moments:
    """What can be while some operations are watched from their start to their end; all others happen at once.

    What runs holds the locks of its closure at the start. Nothing begins, and nothing is committed, that needs a
    branch which another has locked; a commit that turns out to move more than was locked waits for it.

    Args:
        space: The joint states.
        observed: The operations to watch, ``branch.operation``.

    Attributes:
        reached: All moments that can be; the digits of a moment are those of the joint state, then one for each
            operation watched: 0 while it is not running, else which locks it holds.
        transitions: Every way from one moment to another.

    Raises:
        TooManyError: There are more than `MOMENTS_PER_STATE` times as many moments as there may be joint states.
    """

    def __init__(self, space: Space, observed: frozenset[str]) -> None:
        self._observed = [operation for operation in space.operations if operation.name in observed]
        self._locks = {each.name: sorted(_locks(each), key=_sorted) for each in self._observed}
        joint = dict(zip(space.encoding.names, space.encoding.values, strict=True))
        running = {name: ["", *map(str, range(len(locks)))] for name, locks in self._locks.items()}
        self._encoding = Encoding({**joint, **running})
        self._accepting: dict[str, list[Transition]] = {operation.name: [] for operation in space.operations}
        self._stranded: list[Transition] = []
        self.transitions: list[Transition] = []
        for operation, decision in space.decisions():
            self._take(operation, decision)
        self.reached = self._search(space) if self._observed else space.reached

    def way_to(self, code: int) -> tuple[str, ...]:
        """The commands of a shortest way to a moment."""
        return self.reached.way_to(code, self.transitions)

    def decoded(self, code: int) -> tuple[dict[str, str], list[tuple[str, Locks]]]:
        """The joint state of a moment, and what runs at it with the locks that it holds."""
        values = self._encoding.decoded(code)
        running = [(name, held[int(values[name])]) for name, held in self._locks.items() if values[name]]
        return {name: value for name, value in values.items() if name not in self._locks}, running

    def shown(self, code: int) -> str:
        """A moment in a line."""
        states, running = self.decoded(code)
        said = line_of(states)
        return f"{said} while {' and '.join(name for name, _ in running)} runs" if running else said

    def hold(self, condition: Condition, batch: Batch) -> NDArray[np.bool_]:
        """At which moments of a batch a condition holds; shape (n,)."""
        found = batch.matching(condition.states)
        if condition.running:
            found &= np.logical_or.reduce([self.running(name, batch) for name in condition.running])
        for name in condition.accepted:
            found &= ~self.stranded(batch) if name == STOP else _marked(self._accepting.get(name, ()), batch)
        return found

    def running(self, name: str, batch: Batch) -> NDArray[np.bool_]:
        """At which moments an operation runs; one that is never asked for from outside never does."""
        if name not in self._locks:
            return np.zeros(len(batch.codes), dtype=np.bool_)
        return batch.digit(self._encoding.position[name]) > 0

    def stranded(self, batch: Batch) -> NDArray[np.bool_]:
        """At which moments an operation that is watched runs and none of its endings is allowed."""
        return _marked(self._stranded, batch)

    def _search(self, space: Space) -> Reached:
        limit = MOMENTS_PER_STATE * space.limit
        initial = np.array([self._encoding.code(space.blueprint.initial())], dtype=np.int64)
        grouped = by_guard(self.transitions)
        try:
            return search(self._encoding, initial, lambda batch: successors(grouped, batch), limit=limit)
        except TooManyError as error:
            raise TooManyError(f"While {' or '.join(self._locks)} may run: {error}") from error

    def _take(self, operation: Decisions, decision: Decision) -> None:
        """Adds the transitions of an operation where a decision is taken."""
        where = guard(self._encoding, decision)
        if not isinstance(decision.answer, Closure):
            if operation.name in self._locks:
                digit = self._encoding.position[operation.name]
                stays = {**where, digit: tuple(range(1, self._encoding.sizes[digit]))}
                self._stranded.append(self._transition(operation, operation.name, stays, {}))
            return
        free = {**where, **self._free(operation, (decision.answer.writes, decision.answer.reads))}
        begun = self._starts if operation.name in self._locks else self._at_once
        found = list(begun(operation, decision, free))
        self._accepting[operation.name] += found
        self.transitions += found
        if operation.name in self._locks:
            may_move = (decision.answer.writes, frozenset[str]())
            self.transitions += self._ends(operation, decision, {**where, **self._free(operation, may_move)})

    def _starts(
        self, operation: Decisions, decision: Decision, where: dict[int, tuple[int, ...]]
    ) -> Iterator[Transition]:
        closure = decision.answer
        if isinstance(closure, Closure):
            digit = self._encoding.position[operation.name]
            held = self._locks[operation.name].index((closure.writes, closure.reads)) + 1
            command = f"{operation.name}:{STARTED}"
            yield self._transition(operation, command, {**where, digit: (0,)}, {digit: held})

    def _at_once(
        self, operation: Decisions, decision: Decision, where: dict[int, tuple[int, ...]]
    ) -> Iterator[Transition]:
        for command, change in endings_of(operation, decision).items():
            targets = {} if change is None else digits(self._encoding, change.targets)
            yield self._transition(operation, command, where, targets)

    def _ends(
        self, operation: Decisions, decision: Decision, where: dict[int, tuple[int, ...]]
    ) -> Iterator[Transition]:
        digit = self._encoding.position[operation.name]
        for command, change in endings_of(operation, decision).items():
            targets = {} if change is None else digits(self._encoding, change.targets)
            for held in range(1, self._encoding.sizes[digit]):
                yield self._transition(operation, command, {**where, digit: (held,)}, {**targets, digit: 0})

    def _free(self, operation: Decisions, locks: Locks) -> dict[int, tuple[int, ...]]:
        """What the other operations that are watched may be at when this one needs these locks."""
        free: dict[int, tuple[int, ...]] = {}
        for name, held in self._locks.items():
            allowed = (0, *(n for n, other in enumerate(held, 1) if not _conflict(locks, other)))
            if name != operation.name and len(allowed) <= len(held):
                free[self._encoding.position[name]] = allowed
        return free

    def _transition(
        self, operation: Decisions, command: str, where: dict[int, tuple[int, ...]], targets: dict[int, int]
    ) -> Transition:
        return Transition.of(self._encoding, command, (operation.branch, operation.operation), where, targets)


def _marked(transitions: Iterable[Transition], batch: Batch) -> NDArray[np.bool_]:
    found = np.zeros(len(batch.codes), dtype=np.bool_)
    for transition in transitions:
        found[transition.rows(batch)] = True
    return found


def _locks(operation: Decisions) -> set[Locks]:
    closures = (decision.answer for decision in operation.known)
    return {(closure.writes, closure.reads) for closure in closures if isinstance(closure, Closure)}


def _sorted(locks: Locks) -> tuple[list[str], list[str]]:
    return sorted(locks[0]), sorted(locks[1])


def _conflict(one: Locks, other: Locks) -> bool:
    """Whether two locks cannot be held together: one writes what the other reads or writes."""
    return bool(one[0] & (other[0] | other[1]) or one[1] & other[0])
