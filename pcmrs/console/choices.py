"""What may be asked for now, and of everything else why not. Pure; the daemon decides all the same."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.fsm import Blueprint, Engine, OperationSpec
from pcmrs.fsm.closure import Denial
from pcmrs.messages import Snapshot
from pcmrs.messages.setup import Setup


def latch_of(shown: Snapshot | None) -> str | None:
    """Name of the text that says whether a latched Stop is confirmed; None where Stop is not latched."""
    if shown is None or not shown.latched:
        return None
    return "latched_standing" if shown.stop.confirmed else "latched_unconfirmed"


@dataclass(frozen=True, slots=True)
class Choice:
    """One operation for a person to ask for.

    Attributes:
        title: In the workflow's words, or its name.
        why_not: Why it would be rejected now; empty if it would not, as far as a console can tell.
        payload: Registered name of its arguments' type; ``none`` for none.
        moves: Whether it moves the robot.
        stop: Number of the Stop that an acknowledgement answers: the one that the person was shown. None of others.
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
        """By name, what people may ask for, in the blueprint's order."""
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
