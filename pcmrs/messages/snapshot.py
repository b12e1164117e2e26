"""The joint state of a workflow, as it is published."""

from __future__ import annotations

from typing import Any

from pcmrs.messages.base import Message


class Running(Message, frozen=True, kw_only=True, omit_defaults=False):
    """An operation in progress; `progress` grows from 0 to 1."""

    branch: str
    operation: str
    id: str
    progress: float = 0.0


class ActiveActivity(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The activity of the state that a branch is in; `values` are what it shows of itself."""

    branch: str
    state: str
    name: str
    values: dict[str, Any] = {}


class UnknownOutcome(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A command of which nobody knows how it ended, until an operator has settled that.

    Attributes:
        command: Its id.
        source: Who asked for it.
        since: When it began, or where that is not known when its outcome was given up; Unix seconds.
    """

    command: str
    source: str
    branch: str
    operation: str
    since: float


class BlueprintTag(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Which workflow a decision was made under; `hash` is the SHA-256 of what the blueprint says."""

    id: str
    version: str
    hash: str


class LeaseState(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Who holds the cell, and who asks to have it instead."""

    holder: str
    asking: str | None = None


class StopState(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The newest Stop.

    Attributes:
        number: Grows with every Stop, across restarts of the daemon; 0 before the first one. An acknowledgement names
            it.
        pending: What an acknowledgement waits for: ``standstill``, or the code of a danger event.
        confirmed: Standstill was measured after its holds; false while it has only begun.
    """

    number: int = 0
    pending: list[str] = []
    confirmed: bool = False


class Snapshot(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The joint state of all branches after one commit.

    Attributes:
        plan: Id of the accepted tool plan, if any.
        registration: Id of the accepted registration, if any.
        activities: What goes on besides operations, until the state it belongs to is left.
        unknown: Outcomes that nobody knows and no operator has settled yet, of earlier runs of the daemon too.
        lease: None while nobody holds the cell.
        stop: The newest Stop.
        release: Operations of the workflow, ``branch.operation``, that release the latch of Stop; each alone does.
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
    """The flags of snapshot `sequence`, for displays; nothing is decided by them."""

    sequence: int
    flags: dict[str, bool]
