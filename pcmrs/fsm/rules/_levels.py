"""Rules 1 to 3: relations between a branch of level N+1 and the branch of level N that it refines."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from pcmrs.fsm.finding import Finding, Path


def check_levels(blueprint: Blueprint) -> Iterator[Finding]:
    """Return violations of the three rules; every name must exist and every shape be right."""
    for name, branch in blueprint.branches.items():
        yield from _rule_1(name, branch)
        yield from _rule_2(blueprint, name, branch)
        yield from _rule_3(blueprint, name, branch)


def _rule_1(name: str, branch: BranchSpec) -> Iterator[Finding]:
    """Rule 1: every state at level > 1 has a re-initiation operation."""
    path: Path = ("branches", name)
    rios = [key for key, operation in branch.operations.items() if operation.rio]
    if len(rios) > 1:
        text = f"Rule 1: {name} has the re-initiations {' and '.join(rios)}: keep one."
        yield Finding(code="rule_1", text=text, path=(*path, "operations", rios[1]))
    for key in rios[:1]:
        operation, where = branch.operations[key], (*path, "operations", key)
        if operation.outcomes or operation.targets() != {branch.start}:
            text = f"Rule 1: {name}.{key} must lead to the start {branch.start}, and only there."
            yield Finding(code="rule_1", text=text, path=where)
    if branch.level == 1:
        return
    if not rios:
        text = f"Rule 1: {name} is of level {branch.level} and has no re-initiation operation (rio = true)."
        yield Finding(code="rule_1", text=text, path=path)
    for state in branch.states if rios else ():
        if not branch.valid_in(rios[0], state):
            text = f"Rule 1: {name}.{rios[0]} is not valid in {state}: every state needs a re-initiation operation."
            yield Finding(code="rule_1", text=text, path=(*path, "operations", rios[0], "from"))


def _rule_2(blueprint: Blueprint, name: str, branch: BranchSpec) -> Iterator[Finding]:
    """Rule 2: every change at level N+1 calls an operation at level N."""
    if branch.parent is None:
        return
    above, path = blueprint.branches[branch.parent.branch], ("branches", name, "emits")
    for state in branch.states:
        called = branch.emits.get(state)
        if called is None:
            text = f"Rule 2: a change of {name} to {state} calls nothing of {branch.parent.branch}: add it to `emits`."
            yield Finding(code="rule_2", text=text, path=path)
        elif not above.operations[called].iio:
            text = f"Rule 2: {branch.parent.branch}.{called}, called at {name} {state}, must be marked iio = true."
            yield Finding(code="rule_2", text=text, path=(*path, state))


def _rule_3(blueprint: Blueprint, name: str, branch: BranchSpec) -> Iterator[Finding]:
    """Rule 3: a direct change into the parent's start state re-initiates the child: both must fit."""
    parent, path = branch.parent, ("branches", name, "parent", "compatible")
    if parent is None:
        return
    # Both the state of Rule 3 and the parent's start: the workflow begins in the latter.
    for state in dict.fromkeys((parent.start, blueprint.branches[parent.branch].start)):
        if state not in parent.compatible[branch.start]:
            text = f"Rule 3: the start {branch.start} of {name} must fit {parent.branch} {state}, where both start."
            yield Finding(code="rule_3", text=text, path=(*path, branch.start))
