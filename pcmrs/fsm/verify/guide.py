"""Guidance: the shortest allowed way from a joint state to the next stage, to an operation, or out of a Stop.

It is worked out from the joint states and transitions that the verifier finds, so that it is never a guess.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.behaviour import MAX_JOINT_STATES
from pcmrs.fsm.blueprint import Blueprint, StageSpec
from pcmrs.fsm.verify._encoding import Mask
from pcmrs.fsm.verify._relation import Relation
from pcmrs.fsm.verify._search import SearchLimitError
from pcmrs.fsm.verify._space import Operation, StateSpace

Numbers = NDArray[np.int64]

FAR = np.iinfo(np.int64).max // 2
"""Length of a way that does not exist; with the length of a step added, it still is a number."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """A way on from a joint state.

    Attributes:
        stage: The stage that it leads to; None if it leads elsewhere, or if all stages are reached.
        path: Operations of the way, ``branch.operation``, each of which is allowed after those before it have ended as
            hoped; empty if there is none. Events among them are waited for.
    """

    stage: StageSpec | None = None
    path: tuple[str, ...] = ()

    @property
    def next(self) -> str:
        """The first operation of the way; empty if there is none."""
        return self.path[0] if self.path else ""


NO_GUIDANCE = Guidance()


def guide_for(blueprint: Blueprint) -> Guide:
    """Return the guide of a workflow, made once for all procedures of this process.

    Args:
        blueprint: A sound workflow.
    """
    return _guide_for(msgspec.json.encode(blueprint))


@lru_cache(maxsize=16)
def _guide_for(encoded: bytes) -> Guide:
    return Guide(msgspec.json.decode(encoded, type=Blueprint))


class Guide:
    """Way on in one workflow.

    A way is short if it has few operations that no stage names, and then if it has few operations. If no stage names
    any, all operations that users may request count alike. Of two ways that are equally short, the one is taken whose
    first operation comes first: among those that the stage names, then among those of all stages, then in the file.

    A workflow of over `MAX_JOINT_STATES` joint states has no guidance.

    Args:
        blueprint: A sound workflow.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.blueprint = blueprint
        self._ways: dict[tuple[bool, str], Numbers] = {}
        try:
            self._graph: _Graph | None = _Graph(blueprint)
        except SearchLimitError:
            self._graph = None

    def reached(self, states: Mapping[str, str]) -> list[tuple[StageSpec, bool]]:
        """Return the stages that belong to the procedure in a joint state, each with whether it is reached.

        Args:
            states: Joint state: branch to state.
        """
        return [(each, holds(each.goal, states)) for each in self.blueprint.stages if holds(each.when, states)]

    def next_stage(self, states: Mapping[str, str], *, latched: bool = False) -> Guidance:
        """Return the way to the first stage that is not reached; while Stop is latched, the way to its release.

        Args:
            states: Joint state: branch to state.
            latched: Stop is latched.
        """
        if latched and (release := self._release(states)).path:
            return release
        stage = next((each for each, is_reached in self.reached(states) if not is_reached), None)
        graph = self._graph
        place = None if graph is None else graph.find(states)
        if stage is None or graph is None or place is None:
            return Guidance(stage)
        goal = stage.goal
        lengths = self._lengths((False, f"stage {stage.id}"), lambda: graph.lengths(graph.matching(goal)))
        return Guidance(stage, graph.way(place, lengths, preferred=stage.operations))

    def to_operation(self, states: Mapping[str, str], name: str, *, latched: bool = False) -> Guidance:
        """Return the way to an operation, ending with it; while Stop bars it, the way to the release of Stop.

        Args:
            states: Joint state: branch to state.
            name: The operation, ``branch.operation``; a device's event or a call of a child has no way to it.
            latched: Stop is latched.
        """
        branch, _, operation = name.partition(".")
        spec, graph = self.blueprint.find(branch, operation), self._graph
        place = None if graph is None else graph.find(states)
        if spec is None or spec.iio or spec.event or graph is None or place is None:
            return NO_GUIDANCE
        if latched and spec.blocked_when_latched:
            return self._release(states)
        lengths = self._lengths((latched, name), lambda: graph.lengths(graph.accepting(name), latched=latched))
        if lengths[place] >= FAR:
            return NO_GUIDANCE
        return Guidance(None, (*graph.way(place, lengths, latched=latched), name))

    def _release(self, states: Mapping[str, str]) -> Guidance:
        """Return the way to the release of Stop, ending with it."""
        ways = [self._to_release(states, name) for name in self.blueprint.unlatching]
        return min((each for each in ways if each.path), key=lambda each: len(each.path), default=NO_GUIDANCE)

    def _to_release(self, states: Mapping[str, str], name: str) -> Guidance:
        return self.to_operation(states, name, latched=True)

    def _lengths(self, goal: tuple[bool, str], work_out: Callable[[], Numbers]) -> Numbers:
        """Return the lengths of the ways to a goal, worked out when they are first needed."""
        if goal not in self._ways:
            self._ways[goal] = work_out()
        return self._ways[goal]


def holds(requirement: Mapping[str, list[str]], states: Mapping[str, str]) -> bool:
    """Return whether each branch that a requirement names is in one of its states.

    Args:
        requirement: Branch to the states it may be in.
        states: Joint state: branch to state.
    """
    return all(states[branch] in wanted for branch, wanted in requirement.items())


def _declared(space: StateSpace, operation: Operation) -> Relation:
    """Return the transitions of an operation that ends as declared."""
    return space.relation(lambda each: each is operation, declared=True)


class _Graph:
    """Joint states and the transitions that users are led through: those that end as declared.

    Raises:
        SearchLimitError: There are too many joint states.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self._space = space = StateSpace(blueprint, MAX_JOINT_STATES)
        self._codes: Numbers = np.sort(np.concatenate(space.reached.levels))
        self._names = [operation.name for operation in space.operations]
        relations = [_declared(space, each) for each in space.operations]
        found: list[Numbers] = [np.empty((3, 0), dtype=np.int64)]
        for batch in space.reached.batches():
            decisions = space.decided(batch)
            for number, relation in enumerate(relations):
                rows, targets = relation.edges(batch.codes, decisions)
                found.append(np.stack([batch.codes[rows], targets, np.full(len(rows), number)]))
        edges = np.concatenate(found, axis=1)
        sources, targets, self._operations = edges[:, np.argsort(edges[0], kind="stable")]
        self._sources, self._targets = (np.searchsorted(self._codes, each) for each in (sources, targets))
        self._costs = self._costs_of(blueprint)
        barred = [bool(each.spec.blocked_when_latched) for each in space.operations]
        self._barred = np.array(barred, dtype=np.bool_)[self._operations]
        self._order = dict.fromkeys([*blueprint.guided, *self._names])

    @cached_property
    def _firsts(self) -> Numbers:
        """Index of the first transition of each joint state that any leaves."""
        found: Numbers = np.flatnonzero(np.diff(self._sources, prepend=-1))
        return found

    def _costs_of(self, blueprint: Blueprint) -> Numbers:
        """Return the length of each transition: an operation that no stage names is longer than all named ones."""
        guided = set(blueprint.guided)
        unnamed = len(self._codes) + 1 if guided else 1
        events = {operation.name for operation in self._space.operations if operation.spec.event}
        costs = [1 if name in guided else FAR if name in events else unnamed for name in self._names]
        found: Numbers = np.array(costs, dtype=np.int64)[self._operations]
        return found

    def matching(self, goal: Mapping[str, list[str]]) -> Mask:
        """Return a mask of the joint states in which a requirement holds."""
        found: Mask = np.isin(self._codes, self._space.reached.which(lambda batch: batch.matching(goal)))
        return found

    def accepting(self, name: str) -> Mask:
        """Return a mask of the joint states in which an operation is allowed."""
        found = np.zeros(len(self._codes), dtype=np.bool_)
        found[self._sources[self._operations == self._names.index(name)]] = True
        return found

    def lengths(self, goal: Mask, *, latched: bool = False) -> Numbers:
        """Return the length of the shortest way from each joint state to the goal; `FAR` if there is none.

        Args:
            goal: Mask of the joint states to reach.
            latched: Only what the latch of Stop allows may be done on the way.
        """
        found = np.where(goal, 0, FAR).astype(np.int64)
        costs, places = self._steps(latched=latched), self._sources[self._firsts]
        while len(places):
            through = np.minimum(costs + found[self._targets], FAR)
            best = np.minimum.reduceat(through, self._firsts)
            nearer = best < found[places]
            if not nearer.any():
                break
            found[places[nearer]] = best[nearer]
        return found

    def way(
        self, place: int, lengths: Numbers, *, latched: bool = False, preferred: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """Return the operations of the shortest way from a joint state; empty if there is none, or none is needed.

        Args:
            place: Result of `find`.
            lengths: Result of `lengths`.
            latched: As it was given there.
            preferred: Operations that come first if several ways are equally short.
        """
        path: list[str] = []
        costs, ranks = self._steps(latched=latched), list(dict.fromkeys([*preferred, *self._order]))
        while 0 < lengths[place] < FAR:
            leaving = slice(*np.searchsorted(self._sources, [place, place + 1]))
            through = costs[leaving] + lengths[self._targets[leaving]]
            shortest = np.flatnonzero(through == lengths[place]) + leaving.start
            taken = min(shortest, key=lambda edge: ranks.index(self._names[self._operations[edge]]))
            path.append(self._names[self._operations[taken]])
            place = int(self._targets[taken])
        return tuple(path)

    def _steps(self, *, latched: bool) -> Numbers:
        return np.where(self._barred, FAR, self._costs) if latched else self._costs

    def find(self, states: Mapping[str, str]) -> int | None:
        """Return the place of a joint state among the reachable ones; None if it is none of them."""
        code = self._space.encoding.code(states)
        place = int(np.searchsorted(self._codes, code))
        return place if place < len(self._codes) and self._codes[place] == code else None
