"""The branches that an operation reads or moves, and their joint states that can matter."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, OperationSpec, TransitionTarget

MAX_COMBINATIONS = 100_000
"""Limit of combinations that one operation depends on; beyond it an export would be unreadable."""

Joint = dict[str, str]


def coupled(blueprint: Blueprint, branch: str, operation: str) -> list[str]:
    """Return the branches that an operation reads or may move, with their ancestors, in the blueprint's order.

    Args:
        blueprint: The workflow.
        branch: Branch of the operation.
        operation: Name of the operation.
    """
    spec = blueprint.branches[branch].operations[operation]
    seen = {branch, *spec.requires, *_moved(blueprint, branch)}
    for ending in spec.endings.values():
        seen.update(ending.requires)
    for name in list(seen):
        seen.update(ancestors(blueprint, name))
    return [name for name in blueprint.branches if name in seen]


def ancestors(blueprint: Blueprint, branch: str) -> Iterator[str]:
    """Return the branch's parent, the parent's parent and so on.

    Args:
        blueprint: The workflow.
        branch: Name of the branch.
    """
    parent = blueprint.branches[branch].parent
    while parent is not None:
        yield parent.branch
        parent = blueprint.branches[parent.branch].parent


def combinations(blueprint: Blueprint, branches: list[str]) -> Iterator[Joint]:
    """Return the joint states of some branches in which every child fits its parent; the others are at their start.

    Args:
        blueprint: The workflow.
        branches: Names of the branches.

    Raises:
        BlueprintError: There are more than `MAX_COMBINATIONS`.
    """
    number = math.prod(len(blueprint.branches[name].states) for name in branches)
    if number > MAX_COMBINATIONS:
        text = f"{', '.join(branches)} depend on each other in {number} combinations, over {MAX_COMBINATIONS}."
        raise BlueprintError(text, combinations=number, limit=MAX_COMBINATIONS)
    # One branch after the other, so that a child that does not fit is dropped before the branches that follow.
    joints = [blueprint.initial()]
    for place, name in enumerate(branches):
        checked = [child for child in branches if _decided_by(blueprint, child, name, branches[place + 1 :])]
        extended = (joint | {name: state} for joint in joints for state in blueprint.branches[name].states)
        joints = [joint for joint in extended if all(_fits(blueprint, child, joint) for child in checked)]
    yield from joints


def _decided_by(blueprint: Blueprint, child: str, name: str, undecided: list[str]) -> bool:
    """Return true if a child and its parent are decided with the branch `name`, and were not before."""
    parent = blueprint.branches[child].parent
    return parent is not None and name in (child, parent.branch) and not {child, parent.branch} & {*undecided}


def _fits(blueprint: Blueprint, branch: str, joint: Joint) -> bool:
    parent = blueprint.branches[branch].parent
    return parent is None or joint[parent.branch] in parent.compatible[joint[branch]]


def _moved(blueprint: Blueprint, branch: str) -> set[str]:
    """Return every branch that a cascade from `branch` may reach."""
    reached, waiting = {branch}, [branch]
    while waiting:
        for name in _next(blueprint, waiting.pop()) - reached:
            reached.add(name)
            waiting.append(name)
    return reached


def _next(blueprint: Blueprint, branch: str) -> set[str]:
    """Return the branches that a change of `branch` may move at once; a parent that keeps its state passes it on."""
    found = {name for name, spec in blueprint.branches.items() if any(branch in r.by for r in spec.revocations)}
    found.update(blueprint.children[branch])
    while (parent := blueprint.branches[branch].parent) is not None:
        above = blueprint.branches[parent.branch]
        signals = [above.operations[name] for name in blueprint.branches[branch].emits.values()]
        if not all(_keeps(signal, list(above.states)) for signal in signals):
            return found | {parent.branch}
        if not any(signal.signals for signal in signals):
            return found
        branch = parent.branch
    return found


def _keeps(signal: OperationSpec, states: list[str]) -> bool:
    """Return true if a signal keeps every state of the parent."""
    sources = states if signal.from_ == ["*"] else signal.from_
    return all(_target(signal.to, source) == source for source in sources)


def _target(target: TransitionTarget | None, source: str) -> str | None:
    return target.get(source) if isinstance(target, dict) else target
