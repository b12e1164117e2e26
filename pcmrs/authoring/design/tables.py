"""A step table: the critical operations of a procedure as its experts list them, before there is any FSM."""

from __future__ import annotations

from typing import Literal

import msgspec

from pcmrs.fsm.blueprint import ProvenanceSpec
from pcmrs.messages.identity import Role

DECLARATIONS = ("moves", "affects_patient", "irreversible", "confirm")
"""Keys that declare the effect of an action on the patient; a missing key is false if another is given."""


class ActionSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """An action of people; its keys have the same meaning as in an operation of a blueprint.

    Attributes:
        operation: Name of the command.
        payload: Registered name of its arguments' type.
        checks: Failure criteria: registered names of pure checks.
        steps: Registered names of its steps, in order.
        roles: Roles that may ask for it; empty for all roles that may ask for operations.
        timeout_s: Deadline of all steps together, in s of the cell's clock.
        moves: It moves the robot; ``"retreat"`` where it moves it away from the patient only.
        affects_patient: It acts on the patient without moving the robot.
        irreversible: Its effect cannot be undone.
        confirm: A user must confirm it each time.
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
        """Its effect on the patient is declared."""
        return any(getattr(self, key) is not None for key in DECLARATIONS)


class AlternativeSpec(ActionSpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Another way to achieve a step; keys about the patient that it leaves out are as in the step.

    Attributes:
        partial: It may take several attempts: its last step ends as ``partial`` or ``complete``.
    """

    partial: bool = False


class RefinementSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The parts of a step: a branch one level below; exactly one of `steps` and `points` is given.

    Attributes:
        branch: Name of that branch.
        title: Its title.
        steps: Its steps; all of them together achieve the refined step.
        points: Number of points that are performed in order, or their names.
        item: Name of one of counted points.
    """

    branch: str
    title: str = ""
    steps: list[StepSpec] = []
    points: int | list[str] | None = None
    item: str = "point"


class StepSpec(ActionSpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One critical operation and the condition it achieves.

    A refined step is achieved by its refinement: its `operation` is the signal with which the branch below
    reports that, and its name with ``un`` before it is the signal that takes it back. If it is refined by points,
    its other keys define how one point is performed.

    Attributes:
        name: The condition that holds once it is achieved; becomes a flag.
        title: The condition in words.
        depends_on: Steps that must be achieved before.
        reopened_by: Operations that take it back, by name, or as a table if they do more than that.
            Doing a step again always re-opens what depends on it.
        alternatives: Other operations that achieve it.
        refined_by: Its parts.
        source: Sentence of the protocol that it comes from.
        branch: Name of the branch it belongs to; once for all steps that are connected.
    """

    name: str
    title: str = ""
    depends_on: list[str] = []
    reopened_by: list[str | ActionSpec] = []
    alternatives: list[AlternativeSpec] = []
    refined_by: RefinementSpec | None = None
    source: str = ""
    branch: str = ""

    @property
    def meaning(self) -> str:
        """The condition in words."""
        return self.title or self.name.replace("_", " ")

    def reopeners(self) -> list[ActionSpec]:
        """Return the operations that take it back; unless other roles are given, those of the step may take it back."""
        return [
            ActionSpec(operation=each, roles=self.roles) if isinstance(each, str) else each for each in self.reopened_by
        ]


class RequirementSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A promise in terms of steps, for the verifier to prove: exactly one of `operation` and `step` is given.

    Attributes:
        id: Name of the requirement in findings.
        text: The requirement in the words of its users.
        source: Sentence of the protocol that it comes from.
        operation: Whenever this operation of a step runs, or
        step: whenever this step is achieved,
        holds: all these steps are achieved, and
        lacks: none of these.
    """

    id: str
    text: str = ""
    source: str = ""
    operation: str = ""
    step: str = ""
    holds: list[str] = []
    lacks: list[str] = []


class AssumptionSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """An assumption that a draft makes where the protocol says nothing, or something unclear.

    Attributes:
        text: The assumption.
        source: Sentence of the protocol that leaves it open; empty for none.
    """

    text: str
    source: str = ""


class StepTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A whole procedure.

    Attributes:
        id: Name of the workflow.
        version: Its version.
        steps: Its critical operations; the digits of the states are in this order.
        requirements: Its promises, for the verifier to prove.
        assumptions: Assumptions of a draft, for its reader.
        questions: Questions of a draft to the author of the protocol.
        provenance: How a language model has drafted the table; the blueprint keeps it.
        unresolved: What is still wrong with a draft. No workflow is designed from it as long as this is not empty.
    """

    id: str
    version: str
    title: str = ""
    steps: list[StepSpec]
    requirements: list[RequirementSpec] = []
    assumptions: list[AssumptionSpec] = []
    questions: list[str] = []
    provenance: ProvenanceSpec | msgspec.UnsetType = msgspec.UNSET
    unresolved: list[str] = []
