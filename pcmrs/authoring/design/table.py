"""A step table: the critical operations of a procedure as its experts list them, before there is any FSM."""

from __future__ import annotations

from typing import Literal

import msgspec

from pcmrs.messages.identity import Role

DECLARATIONS = ("moves", "affects_patient", "irreversible", "confirm")
"""Keys that say what an action does to the patient; one that is not given is false where another is."""


class ActionSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Something people do; the keys mean what they mean in a blueprint's operation.

    Attributes:
        operation: Name of the command.
        payload: Registered name of its arguments' type.
        checks: Failure criteria: registered names of pure checks.
        steps: Registered names of what is done, in order.
        roles: Who of those who may ask for operations may do it; empty for all of them.
        timeout_s: Deadline of all steps together, in s of the cell's clock.
        moves: It moves the robot; ``"retreat"`` where it moves it away from the patient only.
        affects_patient: It acts on the patient without moving the robot.
        irreversible: What it does cannot be undone.
        confirm: Somebody has to confirm it each time.
    """

    operation: str
    payload: str = "none"
    checks: list[str] = []
    steps: list[str] = []
    roles: list[Role] = []
    timeout_s: float = 5.0
    moves: bool | Literal["approach", "retreat"] | None = None
    affects_patient: bool | None = None
    irreversible: bool | None = None
    confirm: bool | None = None

    @property
    def declared(self) -> bool:
        """Whether anything is said of what it does to the patient."""
        return any(getattr(self, key) is not None for key in DECLARATIONS)


class AlternativeSpec(ActionSpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Another way to achieve a step; what it does not say of the patient is as the step says.

    Attributes:
        partial: It may take several goes: its last step ends as ``partial`` or ``complete``.
    """

    partial: bool = False


class RefinementSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a step consists of: a branch one level below; exactly one of `steps` and `points` is given.

    Attributes:
        branch: Name of that branch.
        title: What it is about.
        steps: Its steps; all of them together achieve the refined step.
        points: How many things are done in order, or their names.
        item: What one of counted points is called.
    """

    branch: str
    title: str = ""
    steps: list[StepSpec] = []
    points: int | list[str] | None = None
    item: str = "point"


class StepSpec(ActionSpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One critical operation and the condition it achieves.

    A refined step is achieved by its refinement: its `operation` is the signal with which the branch below
    says so, and ``un`` before it the one that takes it back. Refined by points, its other keys say how one
    point is performed.

    Attributes:
        name: The condition that holds once it is achieved; becomes a flag.
        title: The same in words.
        depends_on: Steps that must be achieved before.
        reopened_by: Operations that take it back, by name, or described where they do more than that.
            Doing a step again always re-opens what depends on it.
        alternatives: Other operations that achieve it.
        refined_by: What it consists of.
        branch: Name of the branch it belongs to; once for all steps that are connected.
    """

    name: str
    title: str = ""
    depends_on: list[str] = []
    reopened_by: list[str | ActionSpec] = []
    alternatives: list[AlternativeSpec] = []
    refined_by: RefinementSpec | None = None
    branch: str = ""

    @property
    def meaning(self) -> str:
        """The condition in words."""
        return self.title or self.name.replace("_", " ")

    def reopeners(self) -> list[ActionSpec]:
        """What takes it back; who may do it may take it back, unless something else is said."""
        return [
            ActionSpec(operation=each, roles=self.roles) if isinstance(each, str) else each for each in self.reopened_by
        ]


class StepTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A whole procedure.

    Attributes:
        id: Name of the workflow.
        version: Its version.
        steps: Its critical operations; the digits of the states are in this order.
    """

    id: str
    version: str
    title: str = ""
    steps: list[StepSpec]
