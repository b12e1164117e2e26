"""Joint states of a workflow, searched one at a time with nothing but the closure of each operation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from pcmrs.fsm.behaviour import Ruling, branch_states, endings, joint_of
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Closure, close

Joint = tuple[str, ...]
T = TypeVar("T")


def successors(blueprint: Blueprint, joint: Joint) -> dict[Joint, int]:
    """How often each joint state follows on `joint`, worked out with nothing but `answer`."""
    found: dict[Joint, int] = {}
    states = branch_states(blueprint, joint)
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            closure = close(blueprint, states, branch, operation)
            if isinstance(closure, Closure) and not declared.iio:
                for change in endings(declared, closure).values():
                    after = joint if change is None else joint_of(blueprint, change.states)
                    found[after] = found.get(after, 0) + 1
    return found


def remembering_the_last(search: Callable[[Blueprint], T]) -> Callable[[Blueprint], T]:
    """Keeps a result until another workflow is searched: an example asks several times about one."""
    last: list[tuple[Blueprint, T]] = []

    def remembered(blueprint: Blueprint) -> T:
        if not last or last[0][0] is not blueprint:
            last[:] = [(blueprint, search(blueprint))]
        return last[0][1]

    return remembered


@remembering_the_last
def levels(blueprint: Blueprint) -> Mapping[Joint, int]:
    """Every reachable joint state and the length of the shortest way to it."""
    start = joint_of(blueprint, blueprint.initial())
    found, waiting = {start: 0}, [start]
    for joint in waiting:
        for after in successors(blueprint, joint):
            if after not in found:
                found[after] = found[joint] + 1
                waiting.append(after)
    return found


def reachable_from(blueprint: Blueprint, joint: Joint) -> set[Joint]:
    found, waiting = {joint}, [joint]
    for each in waiting:
        new = set(successors(blueprint, each)) - found
        found |= new
        waiting.extend(new)
    return found


def answer_in(blueprint: Blueprint, states: dict[str, str], branch: str, operation: str) -> object:
    """The answer to an operation, without the branches that it does not touch: a code, or endings and their targets."""
    return essence(close(blueprint, states, branch, operation))


def essence(answer: Ruling) -> object:
    """An answer without the branches that it does not touch."""
    if not isinstance(answer, Closure):
        return answer.code
    endings = {**answer.outcomes, "failed": answer.failure, "unknown": answer.unknown}
    return {(name, frozenset(change.targets.items() if change else ())) for name, change in endings.items()}
