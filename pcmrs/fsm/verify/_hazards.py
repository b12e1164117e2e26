"""Hazards to the patient: missing ways back to a safe state, and irreversible operations that can be repeated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.blueprint import BranchSpec, OperationSpec, Requirement, target_from
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify._encoding import Codes
from pcmrs.fsm.verify._liveness import describe_state
from pcmrs.fsm.verify._relation import Relation
from pcmrs.fsm.verify._search import Reached, search, states_leading_to
from pcmrs.fsm.verify._space import Operation, StateSpace
from pcmrs.fsm.verify._structure import path_of
from pcmrs.fsm.verify._transition import Paths


def ways_back(space: StateSpace) -> Iterator[Finding]:
    """Find a joint state from which nothing that a user may ask for leads back to a safe state.

    A state of a branch is safe if the branch can be in it before anything has moved or affected the patient, and if no
    motion ends in it, except a retreat that ends as declared.
    """
    acting = {name: branch for name, branch in space.blueprint.branches.items() if _hazards(branch)}
    if not acting:
        return
    before = _before_any(space)
    safe: Requirement = {}
    for name, branch in acting.items():
        exposed = _exposed(branch)
        seen = _states_seen(space, before, name)
        safe[name] = [state for state in branch.states if state in seen and state not in exposed]
        if not safe[name]:
            key = next(iter(_hazards(branch)))
            text = f"{name} has no state that is safe: one in which it can be before {name}.{key} is first performed, "
            text += "and in which no motion ends but a retreat."
            yield Finding(code="no_way_back", text=text, path=("branches", name))
            return
    wanted = space.reached.which(lambda batch: batch.matching(safe))
    back = states_leading_to(space.reached, wanted, space.leaving(space.intended))
    code = space.reached.first(lambda batch: ~back.has(batch.codes))
    if code is not None:
        where = " and ".join(f"{name} in {' or '.join(states)}" for name, states in safe.items())
        text = f"From {describe_state(space, code)} no operation that ends as declared leads back to safety: {where}."
        way = space.path_to(code)
        yield Finding(code="no_way_back", text=text, path=path_of(way[-1]) if way else ("branches",), commands=way)


def repetitions(space: StateSpace) -> Iterator[Finding]:
    """Find irreversible operations that are accepted again without an operation that allows it."""
    for name, branch in space.blueprint.branches.items():
        for key, operation in branch.operations.items():
            if operation.irreversible:
                allowing = {other for other, spec in branch.operations.items() if key in spec.allows_again}
                yield from _repetition(space, name, key, allowing)


def _repetition(space: StateSpace, branch: str, key: str, allowing: set[str]) -> Iterator[Finding]:
    def is_other(operation: Operation) -> bool:
        return operation.branch != branch or operation.operation not in allowing

    own = space.relation(lambda operation: (operation.branch, operation.operation) == (branch, key))
    onwards = space.relation(is_other)
    accepting = space.reached.which(lambda batch: own.mark(space.decided(batch)))
    after = np.concatenate([space.following(own)(batch) for batch in space.reached.batches()])
    again = _first_accepting(space, _search(space, after, onwards), own) if len(after) else None
    if again is None:
        return
    # A shortest counterexample begins at one of the nearest joint states from which the operation leads there.
    back = states_leading_to(space.reached, np.array([again], dtype=np.int64), space.leaving(onwards))
    for transition in (each for operation, each in space.transitions() if operation.name == f"{branch}.{key}"):
        starts = accepting[transition.holds(space.encoding, accepting)]
        showing = starts[back.has(starts + transition.shift)]
        if not len(showing):
            continue
        first = int(showing[0])
        found = _search(space, np.array([first + transition.shift], dtype=np.int64), onwards)
        second = _first_accepting(space, found, own)
        if second is None:
            raise LookupError("a known joint state cannot be reached")
        others = [each for operation, each in space.transitions() if is_other(operation)]
        paths = Paths(space.encoding, found.levels, others)
        way = (*space.path_to(first), transition.command, *paths.path_to(second))
        text = f"{branch}.{key} is irreversible, and after it was done is accepted again in "
        text += (
            f"{describe_state(space, second)}: bar it there, or name it in `allows_again` of an operation in between."
        )
        yield Finding(code="repeatable", text=text, path=path_of(f"{branch}.{key}"), commands=way)
        return


def _first_accepting(space: StateSpace, reached: Reached, own: Relation) -> int | None:
    """Return one of the nearest joint states in which a transition can be taken."""
    return reached.first(lambda batch: own.mark(space.decided(batch)))


def _search(space: StateSpace, initial: Codes, onwards: Relation) -> Reached:
    following, limit = space.following(onwards), len(space.reached)
    return search(space.encoding, initial, following, limit=limit, within=space.reached.visited)


def _before_any(space: StateSpace) -> Reached:
    """Return the joint states that can be reached before anything has moved or affected the patient."""
    harmless = space.relation(lambda operation: not _is_hazard(operation.spec))
    return _search(space, space.reached.levels[0], harmless)


def _is_hazard(operation: OperationSpec) -> bool:
    return operation.moves or operation.affects_patient


def _hazards(branch: BranchSpec) -> dict[str, OperationSpec]:
    return {key: operation for key, operation in branch.operations.items() if _is_hazard(operation)}


def _exposed(branch: BranchSpec) -> set[str]:
    """Return the states that a motion may leave the branch in, coming from another."""
    found: set[str] = set()
    for key, operation in branch.operations.items():
        if not operation.moves:
            continue
        ends = operation.unconfirmed if operation.motion == "retreat" else operation.endings | operation.unconfirmed
        for source in (state for state in branch.states if branch.valid_in(key, state)):
            found |= {target_from(ending.to, source) for ending in ends.values()} - {source}
    return found


def _states_seen(space: StateSpace, reached: Reached, branch: str) -> set[str]:
    digit = space.encoding.position[branch]
    states = space.encoding.values[digit]
    seen: NDArray[np.bool_] = np.zeros(len(states), dtype=np.bool_)
    for batch in reached.batches():
        seen[batch.digits[digit]] = True
    return {state for state, found in zip(states, seen, strict=True) if found}
