"""Commands, the decisions about them, and queries of the journal over the bus."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pcmrs.messages._base import Message
from pcmrs.messages.identity import ON_SITE, Role

Decision = Literal["accepted", "rejected", "failed", "unknown"]
"""How a command ended: performed, refused before anything happened, failed on the way, or its outcome is unknown."""


class Command(Message, frozen=True, kw_only=True):
    """A request to perform one operation of one branch.

    Attributes:
        id: Id of the command, unique per source; a repeat returns the recorded verdict and runs nothing.
        branch: Branch of the workflow.
        operation: Operation of that branch.
        source: Sender and its route, such as ``udp:planner:127.0.0.1`` or ``bus:local``.
        user: Name of the user, see `Principal`.
        role: Role of the user; the dispatcher enforces it.
        arguments: Arguments of the operation by name.
        sent: Time of sending, Unix seconds; None if the sender gave none.
        ttl: Time after `sent` beyond which the command is refused as expired, s.
        parent: Id of the command whose step submitted this one.
    """

    id: str
    branch: str
    operation: str
    source: str
    user: str = ON_SITE.user
    role: Role = ON_SITE.role
    arguments: dict[str, Any] = {}
    sent: float | None = None
    ttl: float | None = None
    parent: str | None = None


class Reason(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Reason of a refusal or failure.

    Attributes:
        code: Stable code that programs may match on.
        text: One or two sentences for people.
        fields: Values in the text, as data.
    """

    code: str
    text: str
    fields: dict[str, Any] = {}


class Verdict(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Decision of the dispatcher on a command, and the outcome of its operation.

    Attributes:
        id: Id of the command.
        branch: Branch of the command.
        operation: Operation of the command.
        decision: The decision.
        state: State of the branch after the decision.
        sequence: Number of the snapshot that shows the decision.
        reason: Reason if the command was not accepted.
        allowed: Operations of the branch that would not be denied now.
        result: Results of the operation by name, such as ``residual`` in m.
    """

    id: str
    branch: str
    operation: str
    decision: Decision
    state: str
    sequence: int
    reason: Reason | None = None
    allowed: list[str] = []
    result: dict[str, Any] | None = None


class DryRunRequest(Message, frozen=True, kw_only=True):
    """Request for a dry run: the verdict that a command would get now.

    Attributes:
        branch: Branch of the workflow.
        operation: Operation of that branch.
        arguments: Arguments of the operation by name.
    """

    max_bytes: ClassVar[int] = 64 * 1024

    branch: str
    operation: str
    arguments: dict[str, Any] = {}


class DryRunResult(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a dry run by states and checks; the steps of the operation may still fail.

    Attributes:
        reason: Reason for which the command would be rejected; None if it would not be.
        undecided: Texts of the checks that cannot be decided yet.
        result: Results of the checks by name, such as ``tre`` in m.
    """

    reason: Reason | None = None
    undecided: list[str] = []
    result: dict[str, Any] = {}


class NextStepRequest(Message, frozen=True, kw_only=True):
    """Request for the way on.

    Attributes:
        operation: Operation to reach, ``branch.operation``; empty for the next stage of the procedure.
    """

    max_bytes: ClassVar[int] = 1024

    operation: str = ""


class StageShown(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A stage that belongs to the procedure now.

    Attributes:
        id: Name of the stage.
        title: Its purpose, for people.
        reached: True while its goal holds.
    """

    id: str
    title: str
    reached: bool


class NextStep(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The way on from the present states, as the verified workflow allows it; checks may still refuse it.

    Attributes:
        next: First operation of the way, ``branch.operation``; empty if there is none.
        why: Reason why it is next, or why there is none, for people.
        awaited: True if `next` is an event that a device reports, so that it must be waited for.
        path: All operations of the way.
        stage: Stage that the way leads to; empty if it leads to an operation or to the release of Stop.
        stages: All stages that belong to the procedure now, in their order.
    """

    next: str
    why: str
    awaited: bool = False
    path: list[str] = []
    stage: str = ""
    stages: list[StageShown] = []


class JournalQuery(Message, frozen=True, kw_only=True):
    """Request for rows of the journal.

    Attributes:
        after: Only rows with a larger sequence number.
        before: Only rows with a smaller sequence number, and of these the last ones; None for the first ones of all.
        limit: Greatest number of rows. A page has a largest size and may hold fewer; an empty page is the end.
    """

    after: int = 0
    before: int | None = None
    limit: int = 100


class JournalPage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A page of the journal.

    Attributes:
        rows: Rows as plain data, oldest first.
    """

    rows: list[dict[str, Any]]
