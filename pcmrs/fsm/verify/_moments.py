"""Moments: joint states together with the operations that are running in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.behaviour import line_of
from pcmrs.fsm.blueprint import Condition
from pcmrs.fsm.verify._encoding import Batch, Encoding, Mask
from pcmrs.fsm.verify._relation import Edges, Relation
from pcmrs.fsm.verify._search import Reached, SearchBudget, Visited, search, states_leading_to
from pcmrs.fsm.verify._space import Operation, StateSpace, check_encodable, command, digits, guard
from pcmrs.fsm.verify._transition import Allowed, Paths, Transition
from pcmrs.fsm.verify.decision import DecisionCase, LockSets

COST_OF_TRANSITION = 20
"""Looking at a transition at all moments takes as long as examining so many moments."""

STARTED = "started"
"""In place of an outcome in a command: the operation started; its ending comes later or is left open."""

STOP = "stop"
"""Name of Stop in conditions."""

DENIED = -1
"""Kind of the decisions that deny an operation."""

Tables = dict[int, NDArray[np.bool_]]
"""For the digit of each watched operation, which of its values each kind of decision allows, shape (kinds, values)."""


class Moments:
    """Everything that can occur while some operations are watched from start to end; all others happen at once.

    Watched operations may also happen at once, so that a shortest path has no more commands than are needed.

    A running operation holds the locks of its closure at the start. No operation starts or is committed that needs a
    branch which another has locked; a commit that moves more branches than it has locked waits for them.

    Args:
        space: The joint states.
        observed: The operations to watch, ``branch.operation``.
        work: Budget of the search.

    Attributes:
        reached: All moments that can occur; the digits of a moment are those of the joint state, then one for each
            watched operation: 0 while it is not running, else the number of the locks that it holds.

    Raises:
        SearchLimitError: The search exceeds the budget, or there are more combinations than can be encoded.
    """

    def __init__(self, space: StateSpace, observed: frozenset[str], work: SearchBudget) -> None:
        self._space = space
        self._locks = {
            each.name: sorted({decision.locks for decision in each.known if decision.accepted}, key=_sorted)
            for each in space.operations
            if each.name in observed
        }
        joint = dict(zip(space.encoding.names, space.encoding.values, strict=True))
        running = {name: ["", *map(str, range(len(locks)))] for name, locks in self._locks.items()}
        self._encoding = Encoding({**joint, **running})
        check_encodable(self._encoding)
        self._work = work
        self._work.spend(COST_OF_TRANSITION * self._number_of_transitions())
        self._numbers = {operation.name: number for number, operation in enumerate(space.operations)}
        kinds, self._kind = space.kinds
        self._held = np.array([self._held_by(operation.name, locks) for operation, locks in kinds], dtype=np.int64)
        self._may_begin = self._tables([self._beside(operation.name, locks) for operation, locks in kinds])
        self._may_end = self._tables([self._others(operation.name, _writing(locks)) for operation, locks in kinds])
        self.reached = self._search() if self._locks else space.reached

    def path_to(self, code: int) -> tuple[str, ...]:
        """Return the commands of a shortest path to a moment."""
        return self._paths.path_to(code)

    def decoded(self, code: int) -> tuple[dict[str, str], list[tuple[str, LockSets]]]:
        """Return the joint state of a moment, and the running operations with the locks that they hold."""
        values = self._encoding.decoded(code)
        running = [(name, held[int(values[name])]) for name, held in self._locks.items() if values[name]]
        return {name: value for name, value in values.items() if name not in self._locks}, running

    def describe_state(self, code: int) -> str:
        """Return a moment in a line."""
        states, running = self.decoded(code)
        line = line_of(states)
        return f"{line} while {' and '.join(name for name, _ in running)} runs" if running else line

    def hold(self, condition: Condition, batch: Batch) -> Mask:
        """Return a mask of the moments of a batch at which a condition holds; shape (n,).

        Args:
            condition: The condition.
            batch: Some moments.
        """
        found = batch.matching(condition.states)
        if condition.running:
            found &= np.logical_or.reduce([self.running(name, batch) for name in condition.running])
        for name in condition.accepted:
            found &= ~self.stranded(batch) if name == STOP else self._accepted(name, batch)
        return found

    def running(self, name: str, batch: Batch) -> Mask:
        """Return a mask of the moments at which an operation runs; shape (n,).

        Args:
            name: The operation, ``branch.operation``. One that is never asked for from outside never runs.
            batch: Some moments.
        """
        if name not in self._locks:
            return np.zeros(len(batch.codes), dtype=np.bool_)
        running: Mask = batch.digits[self._encoding.position[name]] > 0
        return running

    def stranded(self, batch: Batch) -> Mask:
        """Return a mask of the moments at which a watched operation runs that cannot be concluded; shape (n,)."""
        found = np.zeros(len(batch.codes), dtype=np.bool_)
        for name in self._locks:
            found |= self.running(name, batch) & (self._kinds(name, batch) == DENIED)
        return found

    def states_leading_to(self, condition: Condition) -> Visited:
        """Return the moments from which users can, with declared endings, reach one at which a condition holds."""
        goal = self.reached.which(lambda batch: self.hold(condition, batch))
        intended = self._leaving(self._space.intended, self._space.declared, events=False)
        found = states_leading_to(self.reached, goal, intended, progress=self._work.follow)
        self._work.spend(len(self.reached))
        return found

    def _accepted(self, name: str, batch: Batch) -> Mask:
        if name not in self._numbers:  # called by children only
            return np.zeros(len(batch.codes), dtype=np.bool_)
        accepted: Mask = self._beginning(batch)[self._numbers[name]]
        return accepted

    def _search(self) -> Reached:
        initial = np.array([self._encoding.code(self._space.blueprint.initial())], dtype=np.int64)
        leaving = self._leaving(self._space.all, self._space.all, events=True)
        limit, follow = self._encoding.combinations, self._work.follow
        reached = search(self._encoding, initial, lambda batch: leaving(batch)[1], limit=limit, progress=follow)
        self._work.spend(len(reached))
        return reached

    def _number_of_transitions(self) -> int:
        """Return the number of transitions between moments, and of decisions that a watched operation is denied."""
        number = int(self._space.all.counts.sum())
        for operation in self._space.operations:
            if operation.name in self._locks:
                ends = sum(len(decision.endings) for decision in operation.known)
                number += len(operation.known) + ends * len(self._locks[operation.name])
        return number

    def _leaving(self, at_once: Relation, ends: Relation, *, events: bool) -> Callable[[Batch], Edges]:
        """Return a function that returns the transitions from the moments in a batch.

        Args:
            at_once: Transitions of operations that happen at once.
            ends: Transitions of operations that have run.
            events: Events of devices may begin, too.
        """

        def leaving(batch: Batch) -> Edges:
            decisions, beginning = self._space.decided(batch), self._beginning(batch)
            found = [at_once.edges(batch.codes, decisions, beginning)]
            for name in self._locks:
                number = self._numbers[name]
                digit = self._encoding.position[name]
                weight, held = self._encoding.weights[digit], batch.digits[digit]
                if events or not self._space.operations[number].spec.event:
                    rows = np.flatnonzero(beginning[number])
                    found.append((rows, batch.codes[rows] + weight * self._held[self._kind[decisions[number, rows]]]))
                rows, codes = ends.edges(batch.codes, decisions[[number]], self._ending(name, batch))
                found.append((rows, codes - weight * held[rows]))
            return np.concatenate([rows for rows, _ in found]), np.concatenate([codes for _, codes in found])

        return leaving

    def _beginning(self, batch: Batch) -> NDArray[np.bool_]:
        """Return a mask of the operations that may begin, or happen at once, at moments; shape (operations, n)."""
        return batch.cached(
            "beginning", lambda each: self._free(self._may_begin, self._kind[self._space.decided(each)], each)
        )

    def _ending(self, name: str, batch: Batch) -> Mask:
        """Return a mask of the moments at which a watched operation runs and may end, shape (n,)."""
        return self.running(name, batch) & self._free(self._may_end, self._kinds(name, batch), batch)

    def _kinds(self, name: str, batch: Batch) -> NDArray[np.int64]:
        """Return the kinds of the decisions about an operation at moments, shape (n,)."""
        kinds: NDArray[np.int64] = self._kind[self._space.decided(batch)[self._numbers[name]]]
        return kinds

    def _free(self, tables: Tables, kinds: NDArray[np.int64], batch: Batch) -> NDArray[np.bool_]:
        """Return a mask of kinds of decisions, shape (…, n): nothing that runs at the moments excludes them."""
        free: NDArray[np.bool_] = kinds != DENIED
        for digit, table in tables.items():
            free &= table[kinds, batch.digits[digit]]
        return free

    def _held_by(self, name: str, locks: LockSets) -> int:
        """Return the digit of an operation while it runs with these locks; 0 if it is not watched."""
        return self._locks[name].index(locks) + 1 if name in self._locks else 0

    def _tables(self, guards: list[Allowed]) -> Tables:
        """Return the guards of all kinds, in their order, as tables."""
        tables: Tables = {}
        for name in self._locks:
            digit = self._encoding.position[name]
            tables[digit] = np.ones((len(guards) + 1, self._encoding.sizes[digit]), dtype=np.bool_)  # the last: DENIED
            for kind, allowed in enumerate(guards):
                if digit in allowed:
                    tables[digit][kind] = False
                    tables[digit][kind, allowed[digit]] = True
        return tables

    def _beside(self, name: str, locks: LockSets) -> Allowed:
        """Return the values of all watched operations at which one may begin that takes these locks."""
        own: Allowed = {self._encoding.position[name]: (0,)} if name in self._locks else {}
        return self._others(name, locks) | own

    def _others(self, name: str, locks: LockSets) -> Allowed:
        """Return the values of the other watched operations that do not conflict with these locks."""
        free: Allowed = {}
        for other, held in self._locks.items():
            allowed = (0, *(n for n, theirs in enumerate(held, 1) if not _conflict(locks, theirs)))
            if other != name and len(allowed) <= len(held):
                free[self._encoding.position[other]] = allowed
        return free

    @cached_property
    def _paths(self) -> Paths:
        return Paths(self._encoding, self.reached.levels, self._transitions())

    def _transitions(self) -> Iterator[Transition]:
        """Return all transitions between moments one by one, for the paths in findings."""
        for operation, decision in self._space.decisions():
            name, seen = operation.name, guard(self._encoding, decision)
            where = seen | self._beside(name, decision.locks)
            held = self._locks.get(name)
            if held is not None and decision.accepted:
                started = {self._encoding.position[name]: held.index(decision.locks) + 1}
                yield Transition.of(self._encoding, f"{name}:{STARTED}", where, started)
            for ending, states in decision.endings.items():
                yield Transition.of(self._encoding, command(operation, ending), where, digits(self._encoding, states))
            if held is not None:
                yield from self._conclusions(operation, decision, seen | self._others(name, _writing(decision.locks)))

    def _conclusions(self, operation: Operation, decision: DecisionCase, where: Allowed) -> Iterator[Transition]:
        """Return the transitions of a watched operation that has run and ends where a decision is taken."""
        digit = self._encoding.position[operation.name]
        for ending, states in decision.endings.items():
            targets = digits(self._encoding, states) | {digit: 0}
            for held in range(1, self._encoding.sizes[digit]):
                yield Transition.of(self._encoding, command(operation, ending), {**where, digit: (held,)}, targets)


def _writing(locks: LockSets) -> LockSets:
    """Return the locks that a commit needs."""
    return locks[0], frozenset()


def _sorted(locks: LockSets) -> tuple[list[str], list[str]]:
    return sorted(locks[0]), sorted(locks[1])


def _conflict(one: LockSets, other: LockSets) -> bool:
    """Return true if two locks cannot be held together: one writes what the other reads or writes."""
    return bool(one[0] & (other[0] | other[1]) or one[1] & other[0])
