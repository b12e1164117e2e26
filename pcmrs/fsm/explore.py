"""All joint states a workflow can reach, found by performing every operation in every one of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Change, Closure, Denial, close

MAX_JOINT_STATES = 100_000
"""Beyond this a workflow is refused rather than half checked."""

UNSOUND_DENIALS = frozenset({"cascade_too_long", "no_outcome"})


def explore(blueprint: Blueprint) -> list[dict[str, str]]:
    """Lists the reachable joint states, the initial one first.

    Raises:
        BlueprintError: A cascade does not end, an operation has no way to end, a child does not fit its
            parent, or there are more than `MAX_JOINT_STATES` states.
    """
    start = blueprint.initial()
    found = {tuple(start.values()): start}
    waiting = [start]
    while waiting:
        states = waiting.pop()
        for branch, operation in operations_valid_in(blueprint, states):
            for change in _changes(blueprint, states, branch, operation):
                _check_fit(blueprint, change, f"{branch}.{operation}")
                key = tuple(change.states.values())
                if key not in found:
                    found[key] = dict(change.states)
                    waiting.append(found[key])
        if len(found) > MAX_JOINT_STATES:
            raise BlueprintError(f"over {MAX_JOINT_STATES} joint states: too many to be checked")
    return list(found.values())


def operations_valid_in(blueprint: Blueprint, states: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Branch and operation of everything a user, device, detector or timer may ask for in `states`."""
    for name, branch in blueprint.branches.items():
        for operation, spec in branch.operations.items():
            if not spec.iio and branch.valid_in(operation, states[name]):
                yield name, operation


def _changes(blueprint: Blueprint, states: Mapping[str, str], branch: str, operation: str) -> Iterator[Change]:
    closure = close(blueprint, states, branch, operation)
    if isinstance(closure, Closure):
        yield from closure.outcomes.values()
        yield from (change for change in (closure.failure, closure.unknown) if change is not None)
    elif isinstance(closure, Denial) and closure.code in UNSOUND_DENIALS:
        raise BlueprintError(f"{branch}.{operation} in {dict(states)}: {closure.text}", branch=branch)


def _check_fit(blueprint: Blueprint, change: Change, cause: str) -> None:
    for name, branch in blueprint.branches.items():
        parent = branch.parent
        if parent is not None and change.states[parent.branch] not in parent.compatible[change.states[name]]:
            text = (
                f"rule 3: after {cause}, {name} is in {change.states[name]}, which does not fit "
                f"{parent.branch} in {change.states[parent.branch]}"
            )
            raise BlueprintError(text, branch=name, state=change.states[name])
