"""Exposure of the patient: something is at or in the body, or one command away from acting on it."""

from __future__ import annotations

from collections.abc import Mapping

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, Requirement


class Exposure:
    """States of a workflow in which the patient must not be left alone.

    A state exposes the patient if a motion towards the body leads to it, or if an activity moves the robot in it. So
    does one to which an operation leads that affects the patient. If such an operation needs the tool at the body, and
    no activity runs in the state, it exposes the patient only while the tool is there. A state to which an outcome
    diverts a revocation counts as well: the tool stays at the body. The starting state of a branch, and states to which
    an operation leads that was stopped or has failed, do not count: everything was held.

    Args:
        blueprint: The workflow.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self._by_motion = {
            name: _moved_to(branch) | _diverted_to(blueprint, name) for name, branch in blueprint.branches.items()
        }
        self._by_treatment: dict[tuple[str, str], list[Requirement]] = {}
        for name, branch in blueprint.branches.items():
            for spec in branch.operations.values():
                for state in spec.declared_targets() - {branch.start} if spec.affects_patient else ():
                    needed = {} if state in branch.activities else self._tool_at_body(name, spec)
                    self._by_treatment.setdefault((name, state), []).append(needed)

    def holds(self, joint: Mapping[str, str]) -> bool:
        """Return true if the patient is exposed in a joint state."""
        return any(
            state in self._by_motion.get(branch, ())
            or any(_met(needed, joint) for needed in self._by_treatment.get((branch, state), ()))
            for branch, state in joint.items()
        )

    def _tool_at_body(self, own: str, spec: OperationSpec) -> Requirement:
        """Return those requirements of the operation on other branches that only states exposed by motion meet."""
        return {
            branch: states
            for branch, states in spec.requires.items()
            if branch != own and self._by_motion[branch].issuperset(states)
        }


def _moved_to(branch: BranchSpec) -> set[str]:
    """Return the states in which the robot is moved, or to which it was moved towards the body."""
    approaches = [spec.declared_targets() for spec in branch.operations.values() if spec.motion == "approach"]
    moving = {state for state, activity in branch.activities.items() if activity.moves}
    return moving.union(*approaches) - {branch.start}


def _diverted_to(blueprint: Blueprint, name: str) -> set[str]:
    """Return the states to which outcomes of other branches divert a revocation of a branch."""
    operations = (operation for branch in blueprint.branches.values() for operation in branch.operations.values())
    endings = (ending for operation in operations for ending in operation.outcomes.values())
    return {ending.diverted[name] for ending in endings if name in ending.diverted}


def _met(requirement: Requirement, joint: Mapping[str, str]) -> bool:
    return all(joint.get(branch) in states for branch, states in requirement.items())
