"""Operations that may be asked for now, with reasons for all others. Pure; only the daemon decides."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.console.texts import Texts
from pcmrs.dispatcher.objections import Objections
from pcmrs.fsm import Blueprint, OperationSpec, guide_for
from pcmrs.fsm.closure import Denial
from pcmrs.messages import Snapshot
from pcmrs.messages.setup import Setup


def latch_of(shown: Snapshot | None) -> str | None:
    """Return the name of the text on a latched Stop; None if Stop is not latched."""
    if shown is None or not shown.latched:
        return None
    return "latched_standing" if shown.stop.confirmed else "latched_unconfirmed"


def context_of(shown: Snapshot | None) -> str:
    """Return what a motion depends on besides its name: plan, registration and newest Stop; empty if not known.

    Args:
        shown: The present snapshot; None if it is not known.
    """
    return "" if shown is None else f"{shown.plan} {shown.registration} {shown.stop.number}"


@dataclass(frozen=True, slots=True)
class Choice:
    """One operation that a person may ask for.

    Attributes:
        title: Its title in the workflow, or its name in words.
        why_not: Reason why it would be rejected now; empty if it would not, as far as a console can tell.
        payload: Registered name of its arguments' type; ``none`` for none.
        moves: It moves the robot.
        stop: For an acknowledgement, the number of the Stop that the person was shown; None for other operations.
        context: For what moves the robot or affects the patient, `context_of` the snapshot; empty for the rest.
    """

    branch: str
    operation: str
    title: str
    why_not: str
    payload: str
    moves: bool
    stop: int | None = None
    context: str = ""

    @property
    def name(self) -> str:
        return f"{self.branch}.{self.operation}"

    @property
    def meaning(self) -> str:
        """What a press does; empty if it does nothing. A motion to another plan is another meaning."""
        return "" if self.why_not else f"{self.name} {self.stop} {self.context}"


class Choices:
    """The operations of one workflow.

    Args:
        blueprint: The workflow.
        texts: Texts in the language of the page.
    """

    def __init__(self, blueprint: Blueprint, texts: Texts) -> None:
        self.blueprint = blueprint
        self._texts = texts
        self._guide = guide_for(blueprint)

    def all(self, shown: Snapshot, setup: Setup) -> dict[str, Choice]:
        """Return all operations that people may ask for, by name, in the blueprint's order.

        Args:
            shown: The present snapshot.
            setup: Setup of the cell.
        """
        objections = Objections(self.blueprint, shown, setup)
        found = (
            self._choice(name, operation, spec, shown, objections)
            for name, branch in self.blueprint.branches.items()
            for operation, spec in branch.operations.items()
            if not (spec.iio or spec.event)
        )
        return {choice.name: choice for choice in found}

    def _choice(
        self, branch: str, operation: str, spec: OperationSpec, shown: Snapshot, objections: Objections
    ) -> Choice:
        objection = objections.to(branch, operation, spec)
        return Choice(
            branch=branch,
            operation=operation,
            title=self._title(operation, spec),
            why_not=objection if isinstance(objection, str) else self._denied(branch, operation, objection, shown),
            payload=spec.payload,
            moves=spec.moves,
            stop=shown.stop.number if spec.unlatches else None,
            context=context_of(shown) if spec.moves or spec.affects_patient else "",
        )

    def _denied(self, branch: str, operation: str, denial: Denial, shown: Snapshot) -> str:
        """Return why the states do not allow an operation, and which operation leads on to it."""
        name = f"{branch}.{operation}"
        following = self._guide.to_operation(shown.branches, name, latched=shown.latched).next
        found = self.blueprint.find(*following.split(".")) if following else None
        if found is None:
            return denial.text
        title = self._title(following.partition(".")[2], found)
        return f"{denial.text} {self._texts('leads_on', name=title)}"

    def _title(self, operation: str, spec: OperationSpec) -> str:
        """Return what people call an operation."""
        if spec.title:
            return spec.title
        return self._texts("start_again") if spec.rio else operation.replace("_", " ").capitalize()
