"""How a running daemon is: what it has found of itself, and the verdict on that."""

from __future__ import annotations

from typing import Literal

from pcmrs.messages.base import Message
from pcmrs.messages.snapshot import BlueprintTag

HealthStatus = Literal["ok", "degraded", "failed"]
Severity = Literal["degraded", "failed"]
Room = Literal["enough", "little", "none"]
"""What the free space of a disk is to the journal on it."""


class JournalStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The journal.

    Attributes:
        waiting: Rows that wait for the disk.
        oldest_wait: How long the first of them has waited, s of the machine.
        failure: Why it cannot be written; empty while it can.
        free: Free space on its disk, bytes; None where nobody has looked yet.
        room: What that means: with ``none`` no state change is accepted.
    """

    waiting: int
    oldest_wait: float
    failure: str = ""
    free: float | None = None
    room: Room = "enough"


class TaskStanding(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A task of the daemon; one that does not answer is stuck."""

    name: str
    answers: bool
    restarts: int


class NodeStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The process of a driver; one that is given up is not begun anew."""

    driver: str
    devices: list[str]
    restarts: int
    given_up: bool


class DeviceStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A device, as its node tells.

    Attributes:
        device: Its name.
        connected: It is there, as its node said last.
        text: Why not, and what to do.
        heard: Age of its node's last heartbeat, s of the machine; None when there was none.
        data: Age of the last joints or poses that came, s of the machine; None of a device that sends neither.
        dropped: Kind of message to how many came too late at its node to be followed.
    """

    device: str
    connected: bool
    text: str = ""
    heard: float | None = None
    data: float | None = None
    dropped: dict[str, int] = {}


class LoopStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The event loop: how late it answered last, stalls since the start, and the longest of them, s of the machine."""

    lag: float
    stalls: int
    longest: float


class QueueStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A bounded queue: what waits now, how much may wait, and how much did not fit since the start.

    `refused` is None where nothing is counted: what does not fit stops the daemon for safety, or is told to its sender
    only.
    """

    queue: str
    depth: int
    limit: int
    refused: int | None = None


class LatencyStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """From a command's arrival at an edge to its verdict, of all commands that ended with the same decision.

    The performing of the operation is in it, a motion's time too; of rejected commands it is the deciding alone.

    Attributes:
        count: Commands since the start.
        sum: Of all their times, s of the machine.
        p50: Median of the last ones, s.
        p99: 99 % of the last ones took this long at most, s.
        buckets: Upper bound, s, and how many commands since the start took this long at most.
    """

    decision: str
    count: int
    sum: float
    p50: float
    p99: float
    buckets: list[tuple[float, int]]


class HealthReason(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Why a daemon is not well.

    Attributes:
        severity: What it makes of the whole.
        code: Stable name.
        text: What was found.
        remedy: What to do.
    """

    severity: Severity
    code: str
    text: str
    remedy: str


class HealthFacts(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What a daemon has found of itself.

    Attributes:
        uptime: Since it serves, s of the machine.
        versions: Of pcmrs and Python.
        blueprint: The workflow.
        latched: Stop is latched; no sign of illness.
        fail_stop: Code and text of why nothing is accepted any more; empty in operation.
        in_doubt: A stopped robot has not confirmed that it stands.
        recording: Why the session is not recorded any more; empty while it is, or is not to be.
        console: Why the page is not served any more; empty while it is, or is not to be.
        metrics: Why metrics are not served; empty while they are, or are not to be.
        certificate: Until the daemon's own certificate ends, s of the wall clock; None where it has none.
        strays: Failures in the loop that belong to no task.
        datagrams: Datagrams and TCP frames that arrived at the gateway.
        dropped: What was dropped, refused or replaced since the start, by what and where.
        decisions: Decision to how many were made.
        rejections: Reason code to how many commands were rejected for it.
    """

    uptime: float
    versions: dict[str, str]
    blueprint: BlueprintTag
    latched: bool
    fail_stop: str
    in_doubt: bool
    recording: str
    console: str
    metrics: str
    certificate: float | None
    journal: JournalStatus
    tasks: list[TaskStanding]
    nodes: list[NodeStatus]
    devices: list[DeviceStatus]
    loop: LoopStatus
    queues: list[QueueStatus]
    strays: int
    datagrams: int
    dropped: dict[str, int]
    decisions: dict[str, int]
    rejections: dict[str, int]
    latencies: list[LatencyStatus]


class Health(HealthFacts, frozen=True, kw_only=True, omit_defaults=False):
    """The facts and the verdict on them: the answer to ``svc/health``, and told on ``state/health`` now and then."""

    status: HealthStatus
    reasons: list[HealthReason]
