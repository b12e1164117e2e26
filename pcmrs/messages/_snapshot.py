"""Snapshots: the published joint state of all branches of a workflow."""

from __future__ import annotations

from typing import Any, Final

from pcmrs.messages._base import Message

STOP_NOT_NAMED: Final = "stop_not_named"
"""Code of the refusal of an acknowledgement that must name its Stop: daemon and clients refuse it."""


class TouchPrompt(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Prompt for a person with the pointer.

    Attributes:
        text: What to do.
        landmark: Name of the landmark; empty for a point of the skin.
        number: Number of the landmark or point, from 1.
        count: Number of all landmarks or points.
    """

    text: str
    landmark: str
    number: int
    count: int


class Running(Message, frozen=True, kw_only=True, omit_defaults=False):
    """An operation in progress.

    Attributes:
        branch: Branch of the operation.
        operation: Name of the operation.
        id: Id of its command.
        progress: Progress from 0 to 1.
        prompt: What it waits for a person to touch; None if it does not.
    """

    branch: str
    operation: str
    id: str
    progress: float = 0.0
    prompt: TouchPrompt | None = None


class ActiveActivity(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The running activity of a branch's state.

    Attributes:
        branch: Name of the branch.
        state: Its present state.
        name: Name of the activity.
        values: Values that the activity displays, by name.
    """

    branch: str
    state: str
    name: str
    values: dict[str, Any] = {}


class UnknownOutcome(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A command with an unknown outcome, until an operator has settled it.

    Attributes:
        command: Id of the command.
        source: Source of the command.
        branch: Branch of the command.
        operation: Operation of the command.
        since: Start of the command or, if that is unknown, the time at which its outcome was given up; Unix seconds.
    """

    command: str
    source: str
    branch: str
    operation: str
    since: float


class BlueprintTag(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Identification of a workflow.

    Attributes:
        id: Id of its blueprint.
        version: Version of its blueprint.
        hash: SHA-256 of the contents of its blueprint.
    """

    id: str
    version: str
    hash: str


class LeaseState(Message, frozen=True, kw_only=True, omit_defaults=False):
    """State of the lease of a cell.

    Attributes:
        holder: User who holds the cell.
        asking: User who requests to take it over; None if there is none.
    """

    holder: str
    asking: str | None = None


class StopState(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The newest Stop.

    Attributes:
        number: Number that grows with every Stop, across restarts of the daemon; 0 before the first one. An
            acknowledgement names it.
        pending: Conditions that an acknowledgement waits for: ``standstill``, or the code of a danger event.
        confirmed: True if standstill was measured after the holds; False while the Stop has only begun.
    """

    number: int = 0
    pending: list[str] = []
    confirmed: bool = False


class Snapshot(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The joint state of all branches after one commit.

    Attributes:
        sequence: Number that grows with each snapshot.
        branches: State of each branch.
        flags: Flags that mirror the states, for displays.
        running: Operations in progress.
        latched: True if Stop is latched.
        blueprint: Identification of the workflow.
        plan: Id of the accepted tool plan, if any.
        registration: Id of the accepted registration, if any.
        activities: Activities, each of which runs until its state is left.
        unknown: Commands with an unknown outcome that no operator has settled yet, also of earlier runs of the daemon.
        lease: Holder of the cell; None while there is none.
        stop: The newest Stop.
        release: Operations of the workflow, ``branch.operation``, each of which releases the latch of Stop.
    """

    sequence: int
    branches: dict[str, str]
    flags: dict[str, bool]
    running: list[Running]
    latched: bool
    blueprint: BlueprintTag
    plan: str | None = None
    registration: str | None = None
    activities: list[ActiveActivity] = []
    unknown: list[UnknownOutcome] = []
    lease: LeaseState | None = None
    stop: StopState = StopState()
    release: list[str] = []


class Flags(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Flags for displays; no decision depends on them.

    Attributes:
        sequence: Number of the snapshot.
        flags: Flags that mirror its states.
    """

    sequence: int
    flags: dict[str, bool]
