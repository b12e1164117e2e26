"""Operations that may be asked for now, with reasons for all others. Pure; only the daemon decides."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.fsm import Blueprint, Engine, OperationSpec
from pcmrs.fsm.closure import Denial
from pcmrs.messages import Snapshot
from pcmrs.messages.setup import Setup


def latch_of(shown: Snapshot | None) -> str | None:
    """Return the name of the text on a latched Stop; None if Stop is not latched."""
    if shown is None or not shown.latched:
        return None
    return "latched_standing" if shown.stop.confirmed else "latched_unconfirmed"


@dataclass(frozen=True, slots=True)
class Choice:
    """One operation that a person may ask for.

    Attributes:
        title: Its title in the workflow, or its name.
        why_not: Reason why it would be rejected now; empty if it would not, as far as a console can tell.
        payload: Registered name of its arguments' type; ``none`` for none.
        moves: It moves the robot.
        stop: For an acknowledgement, the number of the Stop that the person was shown; None for other operations.
    """

    branch: str
    operation: str
    title: str
    why_not: str
    payload: str
    moves: bool
    stop: int | None = None

    @property
    def name(self) -> str:
        return f"{self.branch}.{self.operation}"


class Choices:
    """The operations of one workflow.

    Args:
        blueprint: The workflow.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.blueprint = blueprint
        self._engine = Engine(blueprint)

    def all(self, shown: Snapshot, setup: Setup) -> dict[str, Choice]:
        """Return all operations that people may ask for, by name, in the blueprint's order.

        Args:
            shown: The present snapshot.
            setup: Setup of the cell.
        """
        self._engine.place(shown.branches)
        found = (
            self._choice(name, operation, spec, shown, setup)
            for name, branch in self.blueprint.branches.items()
            for operation, spec in branch.operations.items()
            if not (spec.iio or spec.event)
        )
        return {choice.name: choice for choice in found}

    def _choice(self, branch: str, operation: str, spec: OperationSpec, shown: Snapshot, setup: Setup) -> Choice:
        return Choice(
            branch=branch,
            operation=operation,
            title=spec.title or operation.replace("_", " ").capitalize(),
            why_not=self._why_not(branch, operation, spec, shown, setup),
            payload=spec.payload,
            moves=spec.moves,
            stop=shown.stop.number if spec.unlatches else None,
        )

    def _why_not(self, branch: str, operation: str, spec: OperationSpec, shown: Snapshot, setup: Setup) -> str:
        if setup.role not in spec.allowed_roles:
            return f"A {setup.role} may not ask for it: {' or '.join(spec.allowed_roles)} may."
        holder = None if shown.lease is None else shown.lease.holder
        if holder not in (None, setup.user) and setup.role != "planner":
            return f"{holder} holds this cell."
        if holder is None and setup.lease_required:
            return "Nobody holds this cell: take the lease first."
        if shown.latched and spec.blocked_when_latched:
            release = " or ".join(self.blueprint.unlatching)
            return f"Stop is latched: acknowledge with {release} first."
        answer = self._engine.ask(branch, operation)
        return answer.text if isinstance(answer, Denial) else ""
