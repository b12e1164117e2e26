"""Joint states together with operations that are running in them: what can happen while something runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.behaviour import line_of
from pcmrs.fsm.blueprint import Condition
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify.decisions import Decisions
from pcmrs.fsm.verify.encoding import Batch, Encoding
from pcmrs.fsm.verify.observed import Decision
from pcmrs.fsm.verify.search import Reached, Visited, Work, leading_to, search
from pcmrs.fsm.verify.space import Ending, Space, digits, encodable, endings_of, guard
from pcmrs.fsm.verify.transition import Choices, Transition

Locks = tuple[frozenset[str], frozenset[str]]
"""Branches locked for writing, and for reading."""

WORK_OF_TRANSITION = 20
"""To make a transition takes as long as to look at so many moments."""

STARTED = "started"
"""In place of an outcome in a command: it began, and how it ends comes later or is left open."""

STOP = "stop"
"""What conditions call Stop."""


class Moments:
    """What can be while some operations are watched from their start to their end; all others happen at once.

    Those that are watched may also happen at once, so that a shortest way counts no more commands than are given.

    What runs holds the locks of its closure at the start. Nothing begins, and nothing is committed, that needs a
    branch which another has locked; a commit that turns out to move more than was locked waits for it.

    Args:
        space: The joint states.
        observed: The operations to watch, ``branch.operation``.
        work: What the search may cost.

    Attributes:
        reached: All moments that can be; the digits of a moment are those of the joint state, then one for each
            operation watched: 0 while it is not running, else which locks it holds.
        transitions: Every way from one moment to another.

    Raises:
        TooManyError: That is more than is left of the work, or more combinations than can be encoded.
    """

    def __init__(self, space: Space, observed: frozenset[str], work: Work) -> None:
        self._observed = [operation for operation in space.operations if operation.name in observed]
        self._locks = {each.name: sorted(_locks(each), key=_sorted) for each in self._observed}
        joint = dict(zip(space.encoding.names, space.encoding.values, strict=True))
        running = {name: ["", *map(str, range(len(locks)))] for name, locks in self._locks.items()}
        self._encoding = Encoding({**joint, **running})
        encodable(self._encoding)
        self._work = work
        self.transitions: list[Transition] = []
        accepting: dict[str, list[Transition]] = {operation.name: [] for operation in space.operations}
        stranded: list[Transition] = []
        for operation, decision in space.decisions():
            accepting[operation.name] += self._begins(operation, decision)
            self._ends(operation, decision)
            stranded += self._stays(operation, decision)
        self._accepting = {name: Choices(transitions) for name, transitions in accepting.items()}
        self._stranded = Choices(stranded)
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
            found &= ~self.stranded(batch) if name == STOP else self._accepted(name, batch)
        return found

    def running(self, name: str, batch: Batch) -> NDArray[np.bool_]:
        """At which moments an operation runs; one that is never asked for from outside never does."""
        if name not in self._locks:
            return np.zeros(len(batch.codes), dtype=np.bool_)
        return batch.digit(self._encoding.position[name]) > 0

    def stranded(self, batch: Batch) -> NDArray[np.bool_]:
        """At which moments an operation that is watched runs and none of its endings is allowed."""
        return batch.remembered(STOP, self._stranded.mark)

    def leading_to(self, condition: Condition) -> Visited:
        """The moments from which what users ask for and what ends as declared leads to where a condition holds."""
        goal = self.reached.which(lambda batch: self.hold(condition, batch))
        intended = [transition for transition in self.transitions if transition.intended]
        found = leading_to(self.reached, goal, intended, progress=self._work.follow)
        self._work.spend(len(self.reached))
        return found

    def _accepted(self, name: str, batch: Batch) -> NDArray[np.bool_]:
        if name not in self._accepting:  # only children call it
            return np.zeros(len(batch.codes), dtype=np.bool_)
        return batch.remembered(name, self._accepting[name].mark)

    def _search(self, space: Space) -> Reached:
        initial = np.array([self._encoding.code(space.blueprint.initial())], dtype=np.int64)
        following = Choices(self.transitions).successors
        limit = self._encoding.combinations
        reached = search(self._encoding, initial, following, limit=limit, progress=self._work.follow)
        self._work.spend(len(reached))
        return reached

    def _begins(self, operation: Decisions, decision: Decision) -> list[Transition]:
        """Add the transitions of an operation that begins, or happens at once, where a decision is taken."""
        closure = decision.answer
        if not isinstance(closure, Closure):
            return []
        where = guard(self._encoding, decision) | self._free(operation, (closure.writes, closure.reads))
        found: list[Transition] = []
        if operation.name in self._locks:
            digit = self._encoding.position[operation.name]
            held = self._locks[operation.name].index((closure.writes, closure.reads)) + 1
            where[digit] = (0,)
            started = Ending(f"{operation.name}:{STARTED}", declared=True, targets={})
            found.append(self._transition(operation, started, where, {digit: held}))
        found += [self._transition(operation, ending, where, {}) for ending in endings_of(operation, decision)]
        self.transitions += found
        return found

    def _ends(self, operation: Decisions, decision: Decision) -> None:
        """Add the transitions of an operation that is watched and ends where a decision is taken."""
        if operation.name not in self._locks or not isinstance(decision.answer, Closure):
            return
        where = guard(self._encoding, decision) | self._free(operation, (decision.answer.writes, frozenset()))
        digit = self._encoding.position[operation.name]
        for ending in endings_of(operation, decision):
            for held in range(1, self._encoding.sizes[digit]):
                found = self._transition(operation, ending, {**where, digit: (held,)}, {digit: 0})
                self.transitions.append(found)

    def _stays(self, operation: Decisions, decision: Decision) -> list[Transition]:
        """Where an operation that is watched runs, and a decision is taken that denies it."""
        if operation.name not in self._locks or isinstance(decision.answer, Closure):
            return []
        digit = self._encoding.position[operation.name]
        where = {**guard(self._encoding, decision), digit: tuple(range(1, self._encoding.sizes[digit]))}
        return [self._transition(operation, Ending(operation.name, declared=False, targets={}), where, {})]

    def _free(self, operation: Decisions, locks: Locks) -> dict[int, tuple[int, ...]]:
        """What the other operations that are watched may be at when this one needs these locks."""
        free: dict[int, tuple[int, ...]] = {}
        for name, held in self._locks.items():
            allowed = (0, *(n for n, other in enumerate(held, 1) if not _conflict(locks, other)))
            if name != operation.name and len(allowed) <= len(held):
                free[self._encoding.position[name]] = allowed
        return free

    def _transition(
        self, operation: Decisions, ending: Ending, where: dict[int, tuple[int, ...]], running: dict[int, int]
    ) -> Transition:
        self._work.spend(WORK_OF_TRANSITION)
        intended = ending.declared and (not operation.spec.event or 0 in running.values())  # once it runs it will end
        targets = digits(self._encoding, ending.targets) | running
        asked = (operation.branch, operation.operation)
        return Transition.of(self._encoding, ending.command, asked, intended, where, targets)


def _locks(operation: Decisions) -> set[Locks]:
    closures = (decision.answer for decision in operation.known)
    return {(closure.writes, closure.reads) for closure in closures if isinstance(closure, Closure)}


def _sorted(locks: Locks) -> tuple[list[str], list[str]]:
    return sorted(locks[0]), sorted(locks[1])


def _conflict(one: Locks, other: Locks) -> bool:
    """Whether two locks cannot be held together: one writes what the other reads or writes."""
    return bool(one[0] & (other[0] | other[1]) or one[1] & other[0])
