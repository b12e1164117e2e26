"""Activities: each begins by entering its state, leaves it when it ends by itself, and moves the robot alone.

Three rules keep anything else from moving while an activity does: a state with a moving activity is entered by
an approach only, which Stop refuses; a motion from there leads elsewhere however it ends, since it takes over; and
motions of other branches require this one to be elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, target_from
from pcmrs.fsm.finding import Finding


def check_activities(blueprint: Blueprint) -> Iterator[Finding]:
    """Return faults of activities, and motions that could run beside one; every name must exist."""
    for name, branch in blueprint.branches.items():
        for state in branch.activities:
            path = ("branches", name, "activities", state)
            for text in _faults(blueprint, name, branch, state):
                yield Finding(code="bad_activity", text=f"The activity of {name} {state} {text}", path=path)
    moving = {name: _moving(branch) for name, branch in blueprint.branches.items() if _moving(branch)}
    for name, states in list(moving.items())[1:]:
        text = f"{next(iter(moving))} and {name} have activities that move the robot: keep those of one branch."
        yield Finding(code="bad_activity", text=text, path=("branches", name, "activities", states[0]))
    for name, states in moving.items():
        yield from _beside(blueprint, name, states)


def _moving(branch: BranchSpec) -> list[str]:
    return [state for state, activity in branch.activities.items() if activity.moves]


def _faults(blueprint: Blueprint, name: str, branch: BranchSpec, state: str) -> Iterator[str]:
    activity = branch.activities[state]
    if state == branch.start:
        yield "would never run in the starting state: only a command that enters a state starts its activity."
    yield from (f"has ended = {activity.ended!r}, which {fault}" for fault in _bad_ending(branch, state))
    if not activity.moves:
        return
    for key in dict.fromkeys(_unfit_ways_in(branch, state)):
        yield f"moves, but {key} leads there, and not as an approach that ends as declared."
    for key, operation in branch.operations.items():
        if operation.moves and branch.valid_in(key, state) and _may_keep(operation, state):
            yield f"moves, and {key} takes over from it: that must lead elsewhere, however it ends."
    if any(rule.to == state for rule in branch.revocations) or _is_put(blueprint, name, state):
        yield "moves, but another branch takes this one there: only its own approach may."


def _bad_ending(branch: BranchSpec, state: str) -> Iterator[str]:
    """Return the reasons why the operation that ends an activity might not leave the state."""
    key = branch.activities[state].ended
    operation = branch.operations[key]
    if not operation.event:
        yield "is not an event: mark it with event = true."
    if operation.blocked_when_latched:
        yield "moves or affects the patient: it must be possible while Stop is latched."
    if operation.checks or operation.requires:
        yield "has checks or requires: nothing may keep it from being performed."
    if not branch.valid_in(key, state):
        yield "is not valid in that state."
    elif _may_keep(operation, state):
        yield "may keep the state: it must lead elsewhere, however it ends."


def _may_keep(operation: OperationSpec, state: str) -> bool:
    """Return true if an operation may leave the branch in the state that it was in."""
    targets = [target_from(ending.to, state) for ending in operation.endings.values()]
    unconfirmed = [operation.on_failure, operation.on_unknown] if operation.steps else []
    return state in targets or any(target is None or target_from(target, state) == state for target in unconfirmed)


def _unfit_ways_in(branch: BranchSpec, state: str) -> Iterator[str]:
    """Return operations that enter a state other than by an approach that succeeds."""
    for key, operation in branch.operations.items():
        sources = [source for source in branch.states if source != state and branch.valid_in(key, source)]
        for ending, spec in (operation.endings | operation.unconfirmed).items():
            enters = any(target_from(spec.to, source) == state for source in sources)
            if enters and (operation.motion != "approach" or ending in operation.unconfirmed):
                yield key


def _is_put(blueprint: Blueprint, name: str, state: str) -> bool:
    """Return true if an operation of another branch sets the state, or takes the branch there by revoking it."""
    operations = [operation for branch in blueprint.branches.values() for operation in branch.operations.values()]
    endings = (ending for operation in operations for ending in operation.outcomes.values())
    return any(operation.sets.get(name) == state for operation in operations) or any(
        ending.diverted.get(name) == state for ending in endings
    )


def _beside(blueprint: Blueprint, name: str, states: list[str]) -> Iterator[Finding]:
    """Return motions of other branches that could run beside a moving activity."""
    for other, branch in blueprint.branches.items():
        for key, operation in branch.operations.items() if other != name else ():
            required = operation.requires.get(name)
            if operation.moves and (required is None or set(required) & set(states)):
                text = f"{other}.{key} moves the robot, as the activities of {name} {', '.join(states)} do: "
                text += f"let it require {name} in other states."
                yield Finding(code="bad_activity", text=text, path=("branches", other, "operations", key))
