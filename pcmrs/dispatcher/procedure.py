"""Present state of a procedure: active states, flags, data and the latch; changed by commits only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Generic

import msgspec

from pcmrs.dispatcher.workflow import C, D, Workflow
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Change, Closure, Denial, Engine, Guidance, flags_of, guide_for
from pcmrs.messages import ActiveActivity, BlueprintTag, LeaseState, Running, Snapshot, StopState, UnknownOutcome

NO_STOP = StopState()
"""State before the first Stop."""


class Procedure(Generic[C, D]):
    """Joint state of one running workflow.

    Args:
        workflow: The workflow.

    Attributes:
        data: Data of the procedure, such as plan and registration.
        latched: A Stop has not been acknowledged: nothing moves or acts on the patient.
        sequence: Number of the newest commit.
        guide: Finds the way on.
    """

    def __init__(self, workflow: Workflow[C, D]) -> None:
        self.blueprint = workflow.blueprint
        self.data = workflow.initial
        self.latched = False
        self.sequence = 0
        self._reserved = 0
        self._settle = workflow.settle
        self._engine = Engine(workflow.blueprint)
        self.guide = guide_for(workflow.blueprint)
        self._flags = flags_of(workflow.blueprint, self._engine.joint())
        self._promised = self._engine.joint()
        self._changed = dict.fromkeys(workflow.blueprint.branches, 0)

    def joint(self) -> dict[str, str]:
        """Return the joint state: branch to state."""
        return self._engine.joint()

    def promised(self) -> dict[str, str]:
        """Return the joint state as it will be once everything that is being journalled is committed."""
        return dict(self._promised)

    def allowed(self, branch: str, states: Mapping[str, str]) -> list[str]:
        """Return the operations of a branch that users may request and that would not be denied.

        Args:
            branch: Name of the branch.
            states: Joint state: branch to state.
        """
        operations = self.blueprint.branches[branch].operations
        able = self._engine.allowed(branch, states)
        return [name for name in able if not (self.latched and operations[name].blocked_when_latched)]

    def ask(self, branch: str, operation: str) -> Closure | Denial:
        """Ask the state object of a branch; return the closure of an allowed operation, or the denial.

        The states are the promised ones: no decision rests on states that a row on its way to the disk has ended.

        Args:
            branch: Name of the branch.
            operation: Name of the operation.
        """
        return self._engine.ask(branch, operation, states=self._promised)

    def way_to(self, branch: str, operation: str) -> Guidance:
        """Return the way from the promised states to an operation; while Stop bars it, to the release of Stop.

        Args:
            branch: Name of the branch.
            operation: Name of the operation.
        """
        return self.guide.to_operation(self._promised, f"{branch}.{operation}", latched=self.latched)

    def changed_since(self, branches: Iterable[str], sequence: int) -> list[str]:
        """Return those of the branches that a later commit has changed, or will once it is durable.

        Args:
            branches: Names of branches.
            sequence: Number of a commit.
        """
        return [branch for branch in branches if self._changed[branch] > sequence]

    def reserve(self, change: Change | None = None) -> int:
        """Promise a commit of `change` and return its sequence number, for the journal to write first."""
        self._reserved += 1
        if change is not None:
            self._promised |= change.targets
            self._changed |= dict.fromkeys(change.moved, self._reserved)
        return self._reserved

    def commit(self, sequence: int, change: Change | None, changes: Mapping[str, Any], *, unlatch: bool) -> None:
        """Commit a change of states and data together.

        Args:
            sequence: Number that `reserve` has returned.
            change: Change of states; None to keep them.
            changes: Changed fields of the data; they need a `change`.
            unlatch: Release the latch.

        Raises:
            BlueprintError: States or flags have changed without a commit: memory is not to be trusted.
        """
        if self._flags != flags_of(self.blueprint, self.joint()):
            raise BlueprintError("The flags do not mirror the states any more.")
        if change is not None:
            targets = change.targets
            data = msgspec.structs.replace(self.data, **changes) if changes else self.data
            data = self._settle(data, self.joint() | targets, change.effects)
            self._engine.place(targets)
            self.data = data
            self._flags = flags_of(self.blueprint, self.joint())
        self.latched = self.latched and not unlatch
        overtaken = sequence <= self.sequence  # by Stop, which shows the latch without waiting for the journal
        self.sequence = self.reserve() if overtaken else sequence
        if change is not None:
            self._changed |= dict.fromkeys(change.moved, self.sequence)

    def latch(self) -> None:
        """Forbid motion until an operation that unlatches is committed."""
        self.latched = True
        self.sequence = self.reserve()

    def forget_promises(self) -> None:
        """Reset the promised states to the present ones, when nothing is being journalled."""
        self._promised = self.joint()

    def snapshot(
        self,
        running: list[Running],
        activities: list[ActiveActivity],
        unknown: list[UnknownOutcome],
        lease: LeaseState | None = None,
        stop: StopState = NO_STOP,
    ) -> Snapshot:
        """Return a snapshot.

        Args:
            running: Running operations.
            activities: Active activities.
            unknown: Outcomes that an operator must settle.
            lease: Lease of the cell; None while nobody holds it.
            stop: The newest Stop.
        """
        blueprint = self.blueprint
        return Snapshot(
            sequence=self.sequence,
            branches=self.joint(),
            flags=dict(self._flags),
            running=running,
            latched=self.latched,
            blueprint=BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash),
            plan=self.data.plan_id,
            registration=self.data.registration_id,
            activities=activities,
            unknown=unknown,
            lease=lease,
            stop=stop,
            release=list(blueprint.unlatching),
        )
