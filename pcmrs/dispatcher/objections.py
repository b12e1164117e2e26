"""Why an operation would be rejected now, as far as a client can tell. Only the daemon decides."""

from __future__ import annotations

from pcmrs.fsm import Blueprint, Engine, OperationSpec
from pcmrs.fsm.closure import Denial
from pcmrs.messages import Snapshot
from pcmrs.messages.setup import Setup


class Objections:
    """Reasons against the operations of one workflow in one state of the cell.

    Args:
        blueprint: The workflow.
        shown: Snapshot of the cell.
        setup: Setup of the cell, with user and role.
    """

    def __init__(self, blueprint: Blueprint, shown: Snapshot, setup: Setup) -> None:
        self._blueprint, self._shown, self._setup = blueprint, shown, setup
        self._engine = Engine(blueprint)
        self._engine.place(shown.branches)

    def to(self, branch: str, operation: str, spec: OperationSpec) -> str | Denial:
        """Return why an operation would be rejected; a `Denial` if the states do not allow it, empty if nothing does.

        Args:
            branch: Branch of the operation.
            operation: Its name.
            spec: Its declaration.
        """
        shown, setup = self._shown, self._setup
        if setup.role not in spec.allowed_roles:
            return f"A {setup.role} may not ask for it: {' or '.join(spec.allowed_roles)} may."
        holder = None if shown.lease is None else shown.lease.holder
        if holder not in (None, setup.user) and setup.role != "planner":
            return f"{holder} holds this cell."
        if holder is None and setup.lease_required:
            return "Nobody holds this cell: take the lease first."
        if shown.latched and spec.blocked_when_latched:
            return f"Stop is latched: acknowledge with {' or '.join(self._blueprint.unlatching)} first."
        answer = self._engine.ask(branch, operation)
        return answer if isinstance(answer, Denial) else ""
