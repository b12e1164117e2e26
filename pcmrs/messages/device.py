"""Calls to device nodes, and what these tell of themselves."""

from __future__ import annotations

from typing import Any

from pcmrs.messages.base import Message
from pcmrs.messages.decisions import Reason


class ActToken(Message, frozen=True, kw_only=True):
    """For which situation a request that acts was made; see `pcmrs.devices.gate`.

    Attributes:
        daemon: Daemon session: random, one for each start of the daemon.
        node: Node session: random, one for each start of the device's node.
        epoch: Hold epoch of the device.
        number: Grows with each request of one daemon to one device.
    """

    daemon: str
    node: str
    epoch: int
    number: int = 0


class GateState(Message, frozen=True, kw_only=True):
    """What a device acts for now: requests that name something else are refused.

    Attributes:
        node: Node session.
        epoch: Hold epoch: every hold raises it.
        latched: The device was stopped, or has just started, and has not been released since.
        daemon: Daemon session that the device acts for; empty until one has released it.
        changes: Grows with every hold and release, so that of two reports of one node the newer is known.
    """

    node: str
    epoch: int
    latched: bool
    daemon: str = ""
    changes: int = 0


class DeviceRequest(Message, frozen=True, kw_only=True):
    """A call to a device node: `method` of its protocol with `arguments`.

    Attributes:
        method: Its name.
        arguments: By name.
        sent: When the daemon sent it, s of its machine's monotonic clock; None where nobody minds that it is late.
        token: Of a request that acts, holds or releases; None of others.
        latch: Whether a request that holds also latches the device; one that only ends a motion does not.
    """

    method: str
    arguments: dict[str, Any] = {}
    sent: float | None = None
    token: ActToken | None = None
    latch: bool = True


class DeviceReply(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A device node's answer: a result, or the reason of the failure.

    Attributes:
        gate: Of a device that acts, as it is after the request.
    """

    result: Any = None
    failure: Reason | None = None
    gate: GateState | None = None


class DeviceEvent(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Something a device reports by itself; `danger` events take the lane of Stop."""

    device: str
    code: str
    text: str
    danger: bool = False
    fields: dict[str, Any] = {}


class Beat(Message, frozen=True, kw_only=True):
    """A heartbeat of the daemon for the device nodes.

    Attributes:
        number: Grows with each beat of a session.
        session: Random, one per start of the daemon.
        alive: Last sign of life of the daemon's loop, s of its machine's monotonic clock.
        sent: When the beat was sent, on the same clock: a beat may be sent long after the sign of life that it carries.
    """

    number: int
    session: str
    alive: float
    sent: float


class NodeBeat(Message, frozen=True, kw_only=True):
    """A heartbeat of a device's node.

    Attributes:
        number: Grows by one each time.
        sent: s of the node's monotonic clock.
        gate: Of a device that acts.
    """

    number: int
    sent: float
    gate: GateState | None = None


class DeviceHealth(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Whether a device node and its device are well.

    Attributes:
        device: Its name.
        connected: It is there.
        text: Why not, and what to do.
        dropped: Kind of message to how many came too late at its node to be followed, since that began.
    """

    device: str
    connected: bool
    text: str = ""
    dropped: dict[str, int] = {}
