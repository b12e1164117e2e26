"""The branches that a state chart can draw inside the state of the parent that they refine.

Such a branch leaves its start only while the parent is in that state, so nothing is lost although the
chart has no state for it elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pcmrs.authoring.exchange.exporting._coupling import combinations, coupled
from pcmrs.authoring.exchange.exporting._events import changes_of, commands_by_operation
from pcmrs.fsm.blueprint import Blueprint, BranchSpec


class Nesting:
    """Branches drawn inside a state of their parents.

    Args:
        blueprint: The workflow.
        nested: The branches.
    """

    def __init__(self, blueprint: Blueprint, nested: frozenset[str]) -> None:
        self.nested = nested
        self._branches = blueprint.branches

    def around(self, branch: str) -> Iterator[str]:
        """Return the branches that a branch is nested in, innermost first."""
        while branch in self.nested:
            parent = self._branches[branch].parent
            branch = parent.branch if parent is not None else ""
            yield branch

    def inside(self, branch: str, state: str) -> list[str]:
        """Return the branches that are drawn in a state, in the blueprint's order.

        Args:
            branch: Name of the branch.
            state: One of its states.
        """
        return [
            n
            for n, s in self._branches.items()
            if n in self.nested and s.parent and (s.parent.branch, s.parent.start) == (branch, state)
        ]

    def active(self, branch: str, joint: Mapping[str, str]) -> bool:
        """Return true if the chart is in a state of the branch: every state around it is active.

        Args:
            branch: Name of the branch.
            joint: The joint state.
        """
        while branch in self.nested:
            parent = self._branches[branch].parent
            if parent is None or joint[parent.branch] != parent.start:
                return False
            branch = parent.branch
        return True

    def holds(self, joint: Mapping[str, str]) -> bool:
        """Return true if every nested branch that is not active is at its start."""
        return not self.broken(joint)

    def broken(self, joint: Mapping[str, str]) -> set[str]:
        """Return the nested branches that have left their start while the chart has no place for that."""
        return {n for n in self.nested if joint[n] != self._branches[n].start and not self.active(n, joint)}

    def entered(self, branch: str, joint: Mapping[str, str]) -> Iterator[tuple[str, str]]:
        """Return the branches and states to name in order to enter a branch's state with all that is nested in it.

        Args:
            branch: Name of the branch.
            joint: Joint state to enter.
        """
        deeper = [pair for child in self.inside(branch, joint[branch]) for pair in self._named(child, joint)]
        yield from deeper or [(branch, joint[branch])]

    def _named(self, branch: str, joint: Mapping[str, str]) -> list[tuple[str, str]]:
        entered = list(self.entered(branch, joint))
        return [] if entered == [(branch, self._branches[branch].start)] else entered


def nesting_of(blueprint: Blueprint) -> Nesting:
    """Return the largest valid nesting, proved by trying every command in every fitting joint state.

    Raises:
        BlueprintError: Too many branches depend on each other.
    """
    nesting = Nesting(blueprint, frozenset(n for n, spec in blueprint.branches.items() if _has_the_shape(spec)))
    while broken := _first_broken(blueprint, nesting):
        nesting = Nesting(blueprint, nesting.nested - broken)
    return nesting


def _has_the_shape(spec: BranchSpec) -> bool:
    """Return true if its start fits any state of the parent, and the others only the one it refines."""
    parent = spec.parent
    return parent is not None and all(
        fitting == [parent.start] for state, fitting in parent.compatible.items() if state != spec.start
    )


def _first_broken(blueprint: Blueprint, nesting: Nesting) -> set[str]:
    if not nesting.nested:
        return set()
    for branch, operation, endings in commands_by_operation(blueprint):
        joints = filter(nesting.holds, combinations(blueprint, coupled(blueprint, branch, operation)))
        changes = [changes_of(blueprint, joint, branch, operation) for joint in joints]
        for command in endings:
            for change in (each.get(command.ending) for each in changes):
                if change is not None and (broken := nesting.broken(change.states)):
                    return broken
    return set()
