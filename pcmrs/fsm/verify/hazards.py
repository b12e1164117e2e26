"""What reaches the patient: a way back to a safe state from everywhere, and nothing irreversible done twice unasked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.blueprint import BranchSpec, OperationSpec, Requirement, target_from
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify.encoding import Batch, Codes
from pcmrs.fsm.verify.liveness import shown
from pcmrs.fsm.verify.search import Reached, leading_to, search
from pcmrs.fsm.verify.space import Space
from pcmrs.fsm.verify.structure import path_of
from pcmrs.fsm.verify.transition import Choices, Transition


def ways_back(space: Space) -> Iterator[Finding]:
    """A joint state from which nothing that a user may ask for leads back to where it is safe.

    A state of a branch is safe if the branch can be in it before anything has moved or affected the patient, and if no
    motion ends in it, a retreat that ends as declared excepted.
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
    back = leading_to(space.reached, wanted, [each for each in space.transitions if each.intended])
    code = space.reached.first(lambda batch: ~back.has(batch.codes))
    if code is not None:
        where = " and ".join(f"{name} in {' or '.join(states)}" for name, states in safe.items())
        text = f"From {shown(space, code)} nothing that ends as declared leads back to a safe state: {where}."
        way = space.way_to(code)
        yield Finding(code="no_way_back", text=text, path=path_of(way[-1]) if way else ("branches",), commands=way)


def repetitions(space: Space) -> Iterator[Finding]:
    """An irreversible operation that is accepted again without an operation that allows it again."""
    for name, branch in space.blueprint.branches.items():
        for key, operation in branch.operations.items():
            if operation.irreversible:
                allowing = {other for other, spec in branch.operations.items() if key in spec.allows_again}
                yield from _repetition(space, name, key, allowing)


def _repetition(space: Space, branch: str, key: str, allowing: set[str]) -> Iterator[Finding]:
    asked = [each for each in space.transitions if (each.branch, each.operation) == (branch, key)]
    others = [each for each in space.transitions if each.branch != branch or each.operation not in allowing]
    accepted, onwards = Choices(asked), Choices(others)
    begun = space.reached.which(accepted.mark)
    again = _first_again(space, begun, asked, onwards, accepted)
    if again is None:
        return
    # A way that shows it: from a nearest joint state in which doing it leads there.
    back = leading_to(space.reached, np.array([again], dtype=np.int64), others)
    for transition in asked:
        starts = _enabled(space, begun, transition)
        showing = starts[back.has(starts + transition.shift)]
        if not len(showing):
            continue
        first = int(showing[0])
        found = _search(space, np.array([first + transition.shift], dtype=np.int64), onwards)
        second = found.first(accepted.mark)
        if second is None:
            raise LookupError("a joint state is known that cannot be reached")
        way = (*space.way_to(first), transition.command, *found.way_to(second, others))
        text = f"{branch}.{key} is irreversible, and after it was done is accepted again in "
        text += f"{shown(space, second)}: bar it there, or name it in `allows_again` of an operation on the way."
        yield Finding(code="repeatable", text=text, path=path_of(f"{branch}.{key}"), commands=way)
        return


def _first_again(
    space: Space, begun: Codes, asked: Sequence[Transition], onwards: Choices, accepted: Choices
) -> int | None:
    """A joint state after the operation in which it is accepted, reached without what allows it again."""
    after = [_enabled(space, begun, each) + each.shift for each in asked]
    if not after:
        return None
    return _search(space, np.unique(np.concatenate(after)), onwards).first(accepted.mark)


def _enabled(space: Space, codes: Codes, transition: Transition) -> Codes:
    """Those of the joint states in which the transition can be taken."""
    return codes[Choices([transition]).mark(Batch(space.encoding, codes))]


def _search(space: Space, initial: Codes, onwards: Choices) -> Reached:
    limit = len(space.reached)
    return search(space.encoding, initial, onwards.successors, limit=limit, within=space.reached.visited)


def _before_any(space: Space) -> Reached:
    """Joint states that can be reached while nothing has moved or affected the patient yet."""
    harmless = Choices(each for each in space.transitions if not _is_hazard(_spec(space, each)))
    return _search(space, space.reached.levels[0], harmless)


def _spec(space: Space, transition: Transition) -> OperationSpec:
    return space.blueprint.branches[transition.branch].operations[transition.operation]


def _is_hazard(operation: OperationSpec) -> bool:
    return operation.moves or operation.affects_patient


def _hazards(branch: BranchSpec) -> dict[str, OperationSpec]:
    return {key: operation for key, operation in branch.operations.items() if _is_hazard(operation)}


def _exposed(branch: BranchSpec) -> set[str]:
    """States that a motion may leave the branch in, coming from another."""
    found: set[str] = set()
    for key, operation in branch.operations.items():
        if not operation.moves:
            continue
        ends = operation.unconfirmed if operation.motion == "retreat" else operation.endings | operation.unconfirmed
        for source in (state for state in branch.states if branch.valid_in(key, state)):
            found |= {target_from(ending.to, source) for ending in ends.values()} - {source}
    return found


def _states_seen(space: Space, reached: Reached, branch: str) -> set[str]:
    digit = space.encoding.position[branch]
    states = space.encoding.values[digit]
    seen: NDArray[np.bool_] = np.zeros(len(states), dtype=np.bool_)
    for batch in reached.batches():
        seen[batch.digit(digit)] = True
    return {state for state, found in zip(states, seen, strict=True) if found}
