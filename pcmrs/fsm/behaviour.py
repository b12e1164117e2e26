"""The answer of a workflow to every operation in every joint state it can reach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Closure, Denial, close

Joint = tuple[str, ...]
"""The states of all branches, in the blueprint's order."""

Ruling = Closure | Denial
"""Answer of a workflow to a requested operation."""

MAX_JOINT_STATES = 20_000
"""Limit beyond which the answers can no longer be reviewed, and a tour through all of them takes too long."""


def operations(blueprint: Blueprint) -> Iterator[tuple[str, str, OperationSpec]]:
    """Branch, name and declaration of every operation, including those that users may not ask for."""
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            yield branch, operation, declared


def joint_of(blueprint: Blueprint, states: Mapping[str, str]) -> Joint:
    """Return the joint state as a tuple.

    Args:
        blueprint: Workflow whose branches give the order.
        states: Joint state: branch to state.
    """
    return tuple(states[branch] for branch in blueprint.branches)


def branch_states(blueprint: Blueprint, joint: Joint) -> dict[str, str]:
    """Return the joint state as branch to state.

    Args:
        blueprint: Workflow whose branches give the order.
        joint: States of all branches, in that order.
    """
    return dict(zip(blueprint.branches, joint, strict=True))


def line_of(states: Mapping[str, str]) -> str:
    """Return a joint state, or a part of one, in a line of text: ``branch=state`` each."""
    return " ".join(f"{branch}={state}" for branch, state in states.items())


def endings(spec: OperationSpec, closure: Closure) -> dict[str, Change | None]:
    """Return every way an allowed operation can end, and what that changes; only steps can fail or leave doubt.

    Args:
        spec: Declaration of the operation.
        closure: Its closure in a joint state.

    Returns:
        Outcome, ``failed`` or ``unknown`` to the change; None where the branches stay as they are.
    """
    unconfirmed = {"failed": closure.failure, "unknown": closure.unknown} if spec.steps else {}
    return {**closure.outcomes, **unconfirmed}


def behaviour(blueprint: Blueprint, limit: int = MAX_JOINT_STATES) -> dict[Joint, dict[str, Ruling]]:
    """Return every reachable joint state, the initial one first, with the answer there to each ``branch.operation``.

    Args:
        blueprint: A workflow that obeys the static rules.
        limit: Largest number of joint states.

    Raises:
        BlueprintError: There are more than `limit` joint states.
    """
    start = joint_of(blueprint, blueprint.initial())
    found: dict[Joint, dict[str, Ruling]] = {start: {}}
    waiting = [start]
    for joint in waiting:
        states = branch_states(blueprint, joint)
        for branch, operation, spec in operations(blueprint):
            answer = found[joint][f"{branch}.{operation}"] = close(blueprint, states, branch, operation)
            if spec.iio or isinstance(answer, Denial):
                continue
            for change in endings(spec, answer).values():
                after = joint if change is None else joint_of(blueprint, change.states)
                if after not in found:
                    found[after] = {}
                    waiting.append(after)
        if len(found) > limit:
            raise BlueprintError(f"over {limit} joint states: too many to list one by one.", limit=limit)
    return found
