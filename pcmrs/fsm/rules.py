"""Rules 1 to 3 and what they rest on, checked when a blueprint is loaded: an unsound one does not start."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Iterator

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.explore import explore

NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
STATE_NAME = re.compile(r"[a-z0-9][a-z0-9_]{0,31}")
RESERVED = frozenset({"ask", "allowed", "activate", "active", "deactivate", "branch", "name", "spec"})


def check_rules(blueprint: Blueprint) -> None:
    """Checks the whole blueprint.

    Raises:
        BlueprintError: The first fault found: which rule, branch, state and operation, and what to do.
    """
    if not blueprint.branches:
        raise BlueprintError("a workflow needs at least one branch")
    for name, branch in blueprint.branches.items():
        _check_names(name, branch)
        _check_flags(blueprint, name, branch)
        _check_parent(blueprint, name, branch)
    for name, branch in blueprint.branches.items():
        for operation_name, operation in branch.operations.items():
            _check_operation(blueprint, name, operation_name, operation)
        _check_revocations(blueprint, name, branch)
        _check_rule_1(name, branch)
        _check_rule_2(blueprint, name, branch)
        _check_rule_3(blueprint, name, branch)
    explore(blueprint)


def _fault(rule: str, branch: str, text: str, **fields: object) -> BlueprintError:
    return BlueprintError(f"{rule}: branch {branch}: {text}", rule=rule, branch=branch, **fields)


def _check_names(name: str, branch: BranchSpec) -> None:
    for word in (name, *branch.operations, *branch.flags):
        if not NAME.fullmatch(word) or keyword.iskeyword(word) or word in RESERVED:
            raise _fault("names", name, f"{word!r} cannot be a name: use a-z, 0-9 and _, no reserved word", word=word)
    if not branch.states:
        raise _fault("names", name, "a branch needs at least one state")
    for state in branch.states:
        if not STATE_NAME.fullmatch(state):
            raise _fault("names", name, f"{state!r} cannot be a state: use a-z, 0-9 and _", state=state)


def _check_flags(blueprint: Blueprint, name: str, branch: BranchSpec) -> None:
    for state in branch.states:
        if branch.flags and (len(state) != len(branch.flags) or set(state) - {"0", "1"}):
            raise _fault("flags", name, f"state {state} has not one digit for each of {branch.flags}", state=state)
    everywhere = [flag for other in blueprint.branches.values() for flag in other.flags]
    for flag in branch.flags:
        if everywhere.count(flag) > 1:
            raise _fault("flags", name, f"flag {flag} is declared twice; one would hide the other", flag=flag)


def _check_parent(blueprint: Blueprint, name: str, branch: BranchSpec) -> None:
    parent = branch.parent
    if parent is None:
        if branch.level != 1:
            raise _fault("levels", name, f"level {branch.level} needs a parent; only level 1 has none")
        return
    above = blueprint.branches.get(parent.branch)
    if above is None:
        raise _fault("levels", name, f"its parent {parent.branch} does not exist")
    if branch.level != above.level + 1:
        raise _fault("levels", name, f"level {branch.level} under {parent.branch} of level {above.level}")
    if set(parent.compatible) != set(branch.states):
        raise _fault("levels", name, f"`compatible` must name exactly its states {list(branch.states)}")
    for state in {parent.start, *(state for states in parent.compatible.values() for state in states)}:
        _known_state(blueprint, name, parent.branch, state)


def _known_state(blueprint: Blueprint, where: str, branch: str, state: str) -> None:
    if branch not in blueprint.branches:
        raise _fault("references", where, f"branch {branch} does not exist")
    if state not in blueprint.branches[branch].states:
        raise _fault("references", where, f"{branch} has no state {state}", state=state)


def _check_operation(blueprint: Blueprint, branch: str, name: str, operation: OperationSpec) -> None:
    def fault(text: str) -> BlueprintError:
        return _fault("operations", branch, f"{name}: {text}", operation=name)

    if (operation.to is None) == (not operation.outcomes):
        raise fault("needs either `to` or `outcomes`")
    if not 0 < operation.timeout_s < math.inf:
        raise fault(f"timeout_s is {operation.timeout_s}; it must be above 0 and finite")
    if not operation.from_ or ("*" in operation.from_ and len(operation.from_) > 1):
        raise fault("`from` names states, or is exactly ['*']")
    if operation.iio and (operation.steps or operation.checks or operation.outcomes):
        raise fault("is called by a child (iio): it has a target, no checks, steps or outcomes")
    if operation.motion != "none" and (operation.on_failure is None or operation.on_unknown is None):
        raise fault("moves: it needs `on_failure` and `on_unknown`, since it cannot end where it began")
    for state in _states_named(operation):
        _known_state(blueprint, branch, branch, state)
    for other, states in _branches_named(operation):
        for state in states:
            _known_state(blueprint, branch, other, state)
    for child in operation.sets:
        if child not in blueprint.children[branch]:
            raise fault(f"sets {child}, which is no child of {branch}")


def _states_named(operation: OperationSpec) -> Iterator[str]:
    yield from (state for state in operation.from_ if state != "*")
    yield from sorted(operation.targets())


def _branches_named(operation: OperationSpec) -> Iterator[tuple[str, list[str]]]:
    yield from operation.requires.items()
    yield from ((child, [state]) for child, state in operation.sets.items())
    for ending in operation.endings.values():
        yield from ending.requires.items()


def _check_revocations(blueprint: Blueprint, name: str, branch: BranchSpec) -> None:
    for revocation in branch.revocations:
        for by in revocation.by:
            if by not in blueprint.branches:
                raise _fault("references", name, f"is revoked by {by}, which does not exist")
        for state in (*revocation.from_, revocation.to):
            _known_state(blueprint, name, name, state)


def _check_rule_1(name: str, branch: BranchSpec) -> None:
    """Rule 1: every state at level > 1 has a re-initiation operation."""
    if branch.level == 1:
        return
    if branch.rio is None:
        raise _fault("rule 1", name, "has no re-initiation operation (rio)")
    operation = branch.operations[branch.rio]
    if operation.to != branch.start:
        raise _fault("rule 1", name, f"{branch.rio} leads to {operation.to}, not to the start {branch.start}")
    for state in branch.states:
        if not branch.valid_in(branch.rio, state):
            raise _fault("rule 1", name, f"state {state} has no re-initiation operation", state=state)


def _check_rule_2(blueprint: Blueprint, name: str, branch: BranchSpec) -> None:
    """Rule 2: every change at level N+1 calls an operation at level N."""
    if branch.parent is None:
        return
    above = blueprint.branches[branch.parent.branch]
    for state in branch.states:
        called = branch.emits.get(state)
        if called is None:
            text = f"a change to state {state} emits nothing to {branch.parent.branch}"
            raise _fault("rule 2", name, text, state=state)
        if called not in above.operations or not above.operations[called].iio:
            text = f"state {state} emits {called}, which is no operation of {branch.parent.branch} with iio = true"
            raise _fault("rule 2", name, text, state=state)
    for state in set(branch.emits) - set(branch.states):
        raise _fault("rule 2", name, f"emits for state {state}, which does not exist", state=state)


def _check_rule_3(blueprint: Blueprint, name: str, branch: BranchSpec) -> None:
    """Rule 3: a direct change into the parent's start state re-initiates the child: both must fit."""
    parent = branch.parent
    if parent is not None and parent.start not in parent.compatible[branch.start]:
        text = f"its start {branch.start} does not fit {parent.branch} {parent.start}, where it starts"
        raise _fault("rule 3", name, text, state=branch.start)
    if parent is not None and blueprint.branches[parent.branch].start not in parent.compatible[branch.start]:
        text = f"its start {branch.start} does not fit the start of {parent.branch}"
        raise _fault("rule 3", name, text, state=branch.start)
