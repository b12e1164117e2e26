"""References in a blueprint: every branch, state and operation that it names exists."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, Condition, OperationSpec, Requirement, TransitionTarget
from pcmrs.fsm.finding import Finding, Path, hint


def check_references(blueprint: Blueprint) -> Iterator[Finding]:
    """Return references to branches, states and operations that do not exist."""
    for name, branch in blueprint.branches.items():
        path = ("branches", name)
        yield from _parent(blueprint, name, branch)
        for key, operation in branch.operations.items():
            yield from _operation_references(blueprint, name, operation, (*path, "operations", key))
        for state, activity in branch.activities.items():
            where = (*path, "activities", state)
            yield from _states_exist(blueprint, {name: [state]}, where)
            yield from _operation_exists(blueprint, f"{name}.{activity.ended}", (*where, "ended"))
        for key, timer in branch.timers.items():
            where = (*path, "timers", key)
            yield from _states_exist(blueprint, {name: timer.states}, (*where, "states"))
            yield from _operation_exists(blueprint, f"{name}.{timer.posts}", (*where, "posts"))
            for restarting in timer.restarted_by:
                yield from _operation_exists(blueprint, restarting, (*where, "restarted_by"))
        for index, revocation in enumerate(branch.revocations):
            where = (*path, "revocations", str(index))
            for by in revocation.by:
                yield from _branch_exists(blueprint, by, (*where, "by"))
            yield from _states_exist(blueprint, {name: revocation.from_}, (*where, "from"))
            yield from _states_exist(blueprint, {name: [revocation.to]}, (*where, "to"))
    yield from _requirement(blueprint, blueprint.goal, ("goal",))
    yield from _stages(blueprint)
    for index, promise in enumerate(blueprint.properties):
        conditions = {"always": promise.always, "never": promise.never, "reachable": promise.reachable}
        for key, condition in (conditions | {"when": promise.when, "leads_to": promise.leads_to}).items():
            if condition is not None:
                yield from _condition(blueprint, condition, ("properties", str(index), key))


def _stages(blueprint: Blueprint) -> Iterator[Finding]:
    for index, stage in enumerate(blueprint.declared_stages):
        path = ("stage", str(index))
        yield from _requirement(blueprint, stage.goal, (*path, "goal"))
        yield from _requirement(blueprint, stage.when, (*path, "when"))
        for operation in stage.operations:
            yield from _operation_exists(blueprint, operation, (*path, "operations"))


def _branch_exists(blueprint: Blueprint, branch: str, path: Path) -> Iterator[Finding]:
    if branch not in blueprint.branches:
        text = f"There is no branch {branch!r}; {hint(branch, blueprint.branches)}"
        yield Finding(code="unknown_branch", text=text, path=path)


def _states_exist(blueprint: Blueprint, states: Requirement, path: Path) -> Iterator[Finding]:
    for branch, named in states.items():
        missing = list(_branch_exists(blueprint, branch, path))
        yield from missing
        for state in () if missing else named:
            if state not in blueprint.branches[branch].states:
                text = f"{branch} has no state {state!r}; {hint(state, blueprint.branches[branch].states)}"
                yield Finding(code="unknown_state", text=text, path=path)


def _requirement(blueprint: Blueprint, requirement: Requirement, path: Path) -> Iterator[Finding]:
    yield from _states_exist(blueprint, requirement, path)
    for branch, states in requirement.items():
        if not states:
            text = f"No state of {branch} is named, so this can never hold: give at least one."
            yield Finding(code="unknown_state", text=text, path=(*path, branch))


def _operation_exists(blueprint: Blueprint, operation: str, path: Path) -> Iterator[Finding]:
    branch, _, name = operation.partition(".")
    spec = blueprint.branches.get(branch)
    if spec is None or name not in spec.operations:
        text = f"There is no operation {operation!r}: write branch.operation."
        yield Finding(code="unknown_operation", text=text, path=path)


def _parent(blueprint: Blueprint, name: str, branch: BranchSpec) -> Iterator[Finding]:
    parent, path = branch.parent, ("branches", name, "parent")
    if parent is None:
        return
    missing = list(_branch_exists(blueprint, parent.branch, (*path, "branch")))
    yield from missing
    if missing:
        return
    yield from _states_exist(blueprint, {parent.branch: [parent.start]}, (*path, "start"))
    for state, fitting in parent.compatible.items():
        yield from _states_exist(blueprint, {name: [state]}, (*path, "compatible"))
        yield from _states_exist(blueprint, {parent.branch: fitting}, (*path, "compatible", state))
    for state, operation in branch.emits.items():
        where = ("branches", name, "emits", state)
        yield from _states_exist(blueprint, {name: [state]}, where)
        yield from _operation_exists(blueprint, f"{parent.branch}.{operation}", where)


def _operation_references(blueprint: Blueprint, branch: str, spec: OperationSpec, path: Path) -> Iterator[Finding]:
    own = {"from": [state for state in spec.from_ if state != "*"]}
    targets = {"to": spec.to, "on_failure": spec.on_failure, "on_unknown": spec.on_unknown}
    own |= {key: _named(target) for key, target in targets.items() if target is not None}
    for key, states in own.items():
        yield from _states_exist(blueprint, {branch: states}, (*path, key))
    yield from _requirement(blueprint, spec.requires, (*path, "requires"))
    yield from _states_exist(blueprint, {child: [state] for child, state in spec.sets.items()}, (*path, "sets"))
    for key in spec.allows_again:
        yield from _operation_exists(blueprint, f"{branch}.{key}", (*path, "allows_again"))
    for name, ending in spec.outcomes.items():
        yield from _states_exist(blueprint, {branch: _named(ending.to)}, (*path, "outcomes", name, "to"))
        yield from _requirement(blueprint, ending.requires, (*path, "outcomes", name, "requires"))
        diverted = {revoked: [state] for revoked, state in ending.diverted.items()}
        yield from _states_exist(blueprint, diverted, (*path, "outcomes", name, "revoked_to"))


def _named(target: TransitionTarget) -> list[str]:
    return [target] if isinstance(target, str) else [*target, *target.values()]


def _condition(blueprint: Blueprint, condition: Condition, path: Path) -> Iterator[Finding]:
    yield from _requirement(blueprint, condition.states, (*path, "states"))
    for operation in condition.running:
        yield from _operation_exists(blueprint, operation, (*path, "running"))
    for operation in condition.accepted:
        if operation != "stop":
            yield from _operation_exists(blueprint, operation, (*path, "accepted"))
