"""Health of a running daemon: the facts that it has found about itself, and the verdict on them."""

from __future__ import annotations

from typing import Literal

from pcmrs.messages._base import Message
from pcmrs.messages._snapshot import BlueprintTag

__all__ = [
    "DeviceStatus",
    "Health",
    "HealthReason",
    "HealthStatus",
    "JournalStatus",
    "LatencyStatus",
    "LoopStatus",
    "NodeStatus",
    "QueueStatus",
    "Room",
    "Severity",
    "TaskStanding",
]

HealthStatus = Literal["ok", "degraded", "failed"]
"""Status of the daemon: the worst severity of its reasons, or ``ok`` without any."""
Severity = Literal["degraded", "failed"]
"""Severity of a reason: the cell works with a restriction, or does not work."""
Room = Literal["enough", "little", "none"]
"""Rating of the free disk space for the journal."""


class JournalStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of the journal.

    Attributes:
        waiting: Number of rows that wait for the disk.
        oldest_wait: Wait of the oldest of them, s of the machine.
        failure: Reason why it cannot be written; empty while it can.
        free: Free space on its disk, bytes; None before the first check.
        room: Rating of the free space: with ``none`` no state change is accepted.
    """

    waiting: int
    oldest_wait: float
    failure: str = ""
    free: float | None = None
    room: Room = "enough"


class TaskStanding(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of a task of the daemon.

    Attributes:
        name: Name of the task.
        answers: False if the task is stuck.
        restarts: Number of restarts since the start of the daemon.
    """

    name: str
    answers: bool
    restarts: int


class NodeStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of the process of a driver.

    Attributes:
        driver: Name of the driver.
        devices: Devices that it serves.
        restarts: Number of restarts since the start of the daemon.
        given_up: True if it has failed too often and is not restarted any more.
    """

    driver: str
    devices: list[str]
    restarts: int
    given_up: bool


class DeviceStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of a device.

    Attributes:
        device: Name of the device.
        connected: True if it is connected by the last report of its node.
        text: Reason why it is not, and what to do.
        heard: Age of its node's last heartbeat, s of the machine; None before the first one.
        data: Age of its last joints or poses, s of the machine; None for a device that sends neither.
        dropped: Number of messages that arrived at its node too late, by kind.
    """

    device: str
    connected: bool
    text: str = ""
    heard: float | None = None
    data: float | None = None
    dropped: dict[str, int] = {}


class LoopStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of the event loop.

    Attributes:
        lag: Delay of its last answer, s of the machine.
        stalls: Number of stalls since the start of the daemon.
        longest: Longest stall, s of the machine.
    """

    lag: float
    stalls: int
    longest: float


class QueueStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of a bounded queue.

    Attributes:
        queue: Name of the queue.
        depth: Number of items that wait now.
        limit: Number of items that may wait.
        refused: Number of items that did not fit since the start. None where they are not counted, because an item that
            does not fit stops the daemon for safety, or is reported to its sender only.
    """

    queue: str
    depth: int
    limit: int
    refused: int | None = None


class LatencyStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Latency from a command's arrival at the daemon to its verdict, for all commands with the same decision.

    It includes the duration of the operation, also that of a motion. For rejected commands it is the decision alone.

    Attributes:
        decision: Decision on the commands.
        count: Number of commands since the start.
        sum: Sum of their latencies, s of the machine.
        p50: Median latency of recent commands, s.
        p99: 99th percentile of the latency of recent commands, s.
        buckets: Upper bound of a bucket, s, and number of commands since the start within it.
    """

    decision: str
    count: int
    sum: float
    p50: float
    p99: float
    buckets: list[tuple[float, int]]


class HealthReason(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Reason why a daemon is not healthy.

    Attributes:
        severity: Effect on the status of the daemon.
        code: Stable name.
        text: Finding, in words.
        remedy: Action that helps.
    """

    severity: Severity
    code: str
    text: str
    remedy: str


class HealthFacts(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Facts that a daemon has found about itself.

    Attributes:
        uptime: Time since the daemon started to serve, s of the machine.
        versions: Versions of pcmrs and Python.
        blueprint: Workflow.
        latched: True if Stop is latched, which is not a fault.
        fail_stop: Code and text of the reason why nothing is accepted any more; empty in operation.
        in_doubt: True if a stopped robot has not confirmed its standstill.
        recording: Reason why the session is not recorded any more; empty while it is, or is not to be.
        console: Reason why the page is not served any more; empty while it is, or is not to be.
        metrics: Reason why metrics are not served; empty while they are, or are not to be.
        certificate: Time until the daemon's own certificate expires, s of the wall clock; None if it has none.
        journal: Status of the journal.
        tasks: Status of the daemon's tasks.
        nodes: Status of the drivers' processes.
        devices: Status of the devices.
        loop: Status of the event loop.
        queues: Status of the bounded queues.
        strays: Number of failures in the loop that belong to no task.
        datagrams: Number of datagrams and TCP frames that arrived at the gateway.
        dropped: Number of items that were dropped, refused or replaced since the start, by kind and place.
        decisions: Number of decisions by kind.
        rejections: Number of rejected commands by reason code.
        latencies: Latency of commands by decision.
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
    """Facts and the verdict on them: the answer to ``svc/health``, published on ``state/health`` every few seconds.

    Attributes:
        status: Verdict.
        reasons: Reasons of a verdict other than ``ok``.
    """

    status: HealthStatus
    reasons: list[HealthReason]
