"""Commands, and what was decided about them.

Reading the journal over the bus.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pcmrs.messages.base import Message
from pcmrs.messages.identity import ON_SITE, Role

Decision = Literal["accepted", "rejected", "failed", "unknown"]


class Command(Message, frozen=True, kw_only=True):
    """A request that one operation of one branch be performed.

    Attributes:
        id: Unique per source; a repeat returns the recorded verdict and runs nothing.
        source: Who asks and which way, such as ``udp:planner:127.0.0.1`` or ``bus:local``.
        user: Who that is: see `Principal`.
        role: What they may do; the dispatcher holds them to it.
        sent: Unix seconds at which it was sent, if the sender said so.
        ttl: Seconds after `sent` beyond which it is refused as expired.
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
    """Why not: a stable code, a sentence, and the values in it."""

    code: str
    text: str
    fields: dict[str, Any] = {}


class Verdict(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What the dispatcher decided, and for operations how they ended.

    Attributes:
        state: State of the branch after the decision.
        allowed: Operations of the branch that would not be denied now.
        result: What the operation reports, such as ``residual`` in m.
        sequence: Number of the snapshot that shows the decision.
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


class Question(Message, frozen=True, kw_only=True):
    """Asks what would be said to a command, without giving it."""

    max_bytes: ClassVar[int] = 64 * 1024

    branch: str
    operation: str
    arguments: dict[str, Any] = {}


class DryRunResult(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What would be said to a command now, by its states and checks; its steps have still to go well.

    Attributes:
        reason: Why it would be rejected; None if it would not.
        undecided: What its checks could not decide yet, in words.
        result: What they have worked out, such as ``tre`` in m.
    """

    reason: Reason | None = None
    undecided: list[str] = []
    result: dict[str, Any] = {}


class JournalQuery(Message, frozen=True, kw_only=True):
    """Asks for rows of the journal.

    Attributes:
        after: Only those with a larger sequence.
        before: Only those with a smaller one, and of these the last ones; None for the first ones of all.
        limit: At most so many. A page may have fewer, since it has a largest size; where it has none there are no more.
    """

    after: int = 0
    before: int | None = None
    limit: int = 100


class JournalPage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Rows of the journal as plain data, oldest first."""

    rows: list[dict[str, Any]]
