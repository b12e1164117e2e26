"""Finds the branches that may be nested: no command may take one from its start while its parent is elsewhere."""

from __future__ import annotations

from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from pcmrs.fsm.exchange.coupling import combinations, coupled
from pcmrs.fsm.exchange.nesting import Nesting
from pcmrs.fsm.exchange.reactions import change_of, commands


def nesting_of(blueprint: Blueprint) -> Nesting:
    """The most branches that can be nested; proved by trying every command in every fitting joint state.

    Raises:
        BlueprintError: Too many branches depend on each other.
    """
    nesting = Nesting(blueprint, frozenset(n for n, spec in blueprint.branches.items() if _has_the_shape(spec)))
    while broken := _first_broken(blueprint, nesting):
        nesting = Nesting(blueprint, nesting.nested - broken)
    return nesting


def _has_the_shape(spec: BranchSpec) -> bool:
    """Its start fits any state of the parent, the others only the one it refines."""
    parent = spec.parent
    return parent is not None and all(
        fitting == [parent.start] for state, fitting in parent.compatible.items() if state != spec.start
    )


def _first_broken(blueprint: Blueprint, nesting: Nesting) -> set[str]:
    if not nesting.nested:
        return set()
    for command in commands(blueprint):
        for joint in combinations(blueprint, coupled(blueprint, command.branch, command.operation)):
            change = change_of(blueprint, joint, command) if nesting.holds(joint) else None
            if change is not None and (broken := nesting.broken(change.states)):
                return broken
    return set()
