"""Undeclared motion: an operation whose steps move must say so, since Stop has to bar it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding


@dataclass(frozen=True, slots=True)
class KnownHazards:
    """Registered functions that are known to move the robot or to act on the patient.

    Args:
        moving: Steps and activities that move the robot.
        affecting: Steps that act on the patient otherwise.

    Attributes:
        moving: Steps and activities that move the robot.
        affecting: Steps that act on the patient otherwise.
    """

    moving: Collection[str] = ()
    affecting: Collection[str] = ()


def check_declared(blueprint: Blueprint, known: KnownHazards) -> Iterator[Finding]:
    """Return operations and activities that do more than they declare; all other rules must hold.

    Args:
        blueprint: The workflow.
        known: Functions with a known effect.
    """
    for name, branch in blueprint.branches.items():
        for key, operation in branch.operations.items():
            path = ("branches", name, "operations", key, "steps")
            moving = [step for step in operation.steps if step in known.moving]
            affecting = [step for step in operation.steps if step in known.affecting]
            if moving and not operation.moves:
                text = f"{name}.{key} has the step {moving[0]}, which moves the robot: declare `motion`."
                yield Finding(code="undeclared", text=text, path=path)
            elif affecting and not (operation.moves or operation.affects_patient):
                text = f"{name}.{key} has the step {affecting[0]}, which acts on the patient: "
                yield Finding(code="undeclared", text=f"{text}declare affects_patient = true.", path=path)
        for state, activity in branch.activities.items():
            if activity.run in known.moving and not activity.moves:
                text = f"The activity {activity.run} of {name} {state} moves the robot: declare moves = true."
                yield Finding(code="undeclared", text=text, path=("branches", name, "activities", state))
