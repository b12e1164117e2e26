"""Moments: joint states together with the operations that are running in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.behaviour import line_of
from pcmrs.fsm.blueprint import Condition
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify.decision_tree import Decision, DecisionTree
from pcmrs.fsm.verify.encoding import Batch, Encoding
from pcmrs.fsm.verify.search import Reached, SearchBudget, Visited, search, states_leading_to
from pcmrs.fsm.verify.space import Ending, Space, check_encodable, digits, endings_of, guard
from pcmrs.fsm.verify.transition import Transition, TransitionTree, most_selective_first

Locks = tuple[frozenset[str], frozenset[str]]
"""Branches locked for writing, and for reading."""

COST_OF_TRANSITION = 20
"""Making a transition takes as long as examining so many moments."""

STARTED = "started"
"""In place of an outcome in a command: the operation started; its ending comes later or is left open."""

STOP = "stop"
"""Name of Stop in conditions."""


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
        transitions: All transitions between moments.

    Raises:
        SearchLimitError: The search exceeds the budget, or there are more combinations than can be encoded.
    """

    def __init__(self, space: Space, observed: frozenset[str], work: SearchBudget) -> None:
        self._space = space
        self._observed = [operation for operation in space.operations if operation.name in observed]
        self._locks = {each.name: sorted(_locks(each), key=_sorted) for each in self._observed}
        joint = dict(zip(space.encoding.names, space.encoding.values, strict=True))
        running = {name: ["", *map(str, range(len(locks)))] for name, locks in self._locks.items()}
        self._encoding = Encoding({**joint, **running})
        check_encodable(self._encoding)
        self._work = work
        self.transitions: list[Transition] = []
        self._accepting: dict[str, list[Transition]] = {operation.name: [] for operation in space.operations}
        self._accepting_trees: dict[str, TransitionTree] = {}
        stranded: list[Transition] = []
        for operation, decision in space.decisions():
            self._accepting[operation.name] += self._begins(operation, decision)
            self._ends(operation, decision)
            stranded += self._stays(operation, decision)
        self._stranded = TransitionTree(stranded)
        self.reached = self._search() if self._observed else space.reached

    def path_to(self, code: int) -> tuple[str, ...]:
        """Return the commands of a shortest path to a moment."""
        return self.reached.path_to(code, self.transitions)

    def decoded(self, code: int) -> tuple[dict[str, str], list[tuple[str, Locks]]]:
        """Return the joint state of a moment, and the running operations with the locks that they hold."""
        values = self._encoding.decoded(code)
        running = [(name, held[int(values[name])]) for name, held in self._locks.items() if values[name]]
        return {name: value for name, value in values.items() if name not in self._locks}, running

    def describe_state(self, code: int) -> str:
        """Return a moment in a line."""
        states, running = self.decoded(code)
        line = line_of(states)
        return f"{line} while {' and '.join(name for name, _ in running)} runs" if running else line

    def hold(self, condition: Condition, batch: Batch) -> NDArray[np.bool_]:
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

    def running(self, name: str, batch: Batch) -> NDArray[np.bool_]:
        """Return a mask of the moments at which an operation runs; shape (n,).

        Args:
            name: The operation, ``branch.operation``. One that is never asked for from outside never runs.
            batch: Some moments.
        """
        if name not in self._locks:
            return np.zeros(len(batch.codes), dtype=np.bool_)
        return batch.digit(self._encoding.position[name]) > 0

    def stranded(self, batch: Batch) -> NDArray[np.bool_]:
        """Return a mask of the moments at which a watched operation runs that cannot be concluded; shape (n,)."""
        return batch.cached(STOP, self._stranded.mark)

    def states_leading_to(self, condition: Condition) -> Visited:
        """Return the moments from which users can, with declared endings, reach one at which a condition holds."""
        goal = self.reached.which(lambda batch: self.hold(condition, batch))
        intended = [transition for transition in self.transitions if transition.intended]
        found = states_leading_to(self.reached, goal, intended, progress=self._work.follow)
        self._work.spend(len(self.reached))
        return found

    def _accepted(self, name: str, batch: Batch) -> NDArray[np.bool_]:
        if name not in self._accepting:  # called by children only
            return np.zeros(len(batch.codes), dtype=np.bool_)
        if name not in self._accepting_trees:  # few conditions name an operation, and a tree takes time to make
            self._accepting_trees[name] = TransitionTree(self._accepting[name])
        return batch.cached(name, self._accepting_trees[name].mark)

    def _search(self) -> Reached:
        initial = np.array([self._encoding.code(self._space.blueprint.initial())], dtype=np.int64)
        following = TransitionTree(self.transitions).successors
        limit = self._encoding.combinations
        reached = search(self._encoding, initial, following, limit=limit, progress=self._work.follow)
        self._work.spend(len(reached))
        return reached

    def _begins(self, operation: DecisionTree, decision: Decision) -> list[Transition]:
        """Add the transitions of an operation that begins, or happens at once, where a decision is taken."""
        closure = decision.answer
        if not isinstance(closure, Closure):
            return []
        free = self._free(operation, (closure.writes, closure.reads))
        found: list[Transition] = []
        if operation.name in self._locks:
            digit = self._encoding.position[operation.name]
            held = self._locks[operation.name].index((closure.writes, closure.reads)) + 1
            free[digit] = (0,)
            started = Ending(f"{operation.name}:{STARTED}", declared=True, targets={})
            where = guard(self._encoding, decision) | free
            found.append(self._transition(operation, started, where, {digit: held}))
        at_once = self._space.transitions_after(decision)
        self._work.spend(COST_OF_TRANSITION * len(at_once))
        if free:
            unhindered = most_selective_first(self._encoding, guard(self._encoding, decision) | free)
            at_once = [replace(each, guard=unhindered) for each in at_once]
        found += at_once
        self.transitions += found
        return found

    def _ends(self, operation: DecisionTree, decision: Decision) -> None:
        """Add the transitions of an operation that is watched and ends where a decision is taken."""
        if operation.name not in self._locks or not isinstance(decision.answer, Closure):
            return
        where = guard(self._encoding, decision) | self._free(operation, (decision.answer.writes, frozenset()))
        digit = self._encoding.position[operation.name]
        for ending in endings_of(operation, decision):
            for held in range(1, self._encoding.sizes[digit]):
                found = self._transition(operation, ending, {**where, digit: (held,)}, {digit: 0})
                self.transitions.append(found)

    def _stays(self, operation: DecisionTree, decision: Decision) -> list[Transition]:
        """Return the transitions that stand for a watched operation which runs where it is denied."""
        if operation.name not in self._locks or isinstance(decision.answer, Closure):
            return []
        digit = self._encoding.position[operation.name]
        where = {**guard(self._encoding, decision), digit: tuple(range(1, self._encoding.sizes[digit]))}
        return [self._transition(operation, Ending(operation.name, declared=False, targets={}), where, {})]

    def _free(self, operation: DecisionTree, locks: Locks) -> dict[int, tuple[int, ...]]:
        """Return the values of the other watched operations that do not conflict with these locks."""
        free: dict[int, tuple[int, ...]] = {}
        for name, held in self._locks.items():
            allowed = (0, *(n for n, other in enumerate(held, 1) if not _conflict(locks, other)))
            if name != operation.name and len(allowed) <= len(held):
                free[self._encoding.position[name]] = allowed
        return free

    def _transition(
        self, operation: DecisionTree, ending: Ending, where: dict[int, tuple[int, ...]], running: dict[int, int]
    ) -> Transition:
        self._work.spend(COST_OF_TRANSITION)
        intended = ending.declared and (
            not operation.spec.event or 0 in running.values()
        )  # once it runs, its device will end it
        targets = digits(self._encoding, ending.targets) | running
        requested = (operation.branch, operation.operation)
        return Transition.of(self._encoding, ending.command, requested, intended, where, targets)


def _locks(operation: DecisionTree) -> set[Locks]:
    closures = (decision.answer for decision in operation.known)
    return {(closure.writes, closure.reads) for closure in closures if isinstance(closure, Closure)}


def _sorted(locks: Locks) -> tuple[list[str], list[str]]:
    return sorted(locks[0]), sorted(locks[1])


def _conflict(one: Locks, other: Locks) -> bool:
    """Return true if two locks cannot be held together: one writes what the other reads or writes."""
    return bool(one[0] & (other[0] | other[1]) or one[1] & other[0])
