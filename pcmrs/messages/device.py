"""Calls to device nodes, and the nodes' replies, events, heartbeats and health."""

from __future__ import annotations

from typing import Any

from pcmrs.messages._base import Message
from pcmrs.messages._decisions import Reason

__all__ = ["ActToken", "Beat", "DeviceEvent", "DeviceHealth", "DeviceReply", "DeviceRequest", "GateState", "NodeBeat"]


class ActToken(Message, frozen=True, kw_only=True):
    """Sessions and hold epoch for which an acting request was made; see `pcmrs.devices.gate`.

    Attributes:
        daemon: Daemon session: random, one for each start of the daemon.
        node: Node session: random, one for each start of the device's node.
        epoch: Hold epoch of the device.
        number: Number that grows with each request of one daemon to one device.
    """

    daemon: str
    node: str
    epoch: int
    number: int = 0


class GateState(Message, frozen=True, kw_only=True):
    """Sessions and hold epoch for which a device acts now: requests that name others are refused.

    Attributes:
        node: Node session.
        epoch: Hold epoch: every hold raises it.
        latched: True if the device was stopped, or has just started, and was not released since.
        daemon: Daemon session for which the device acts; empty until a daemon has released it.
        changes: Number of holds and releases, which shows the newer one of two reports of one node.
    """

    node: str
    epoch: int
    latched: bool
    daemon: str = ""
    changes: int = 0


class DeviceRequest(Message, frozen=True, kw_only=True):
    """A call to a device node: `method` of its protocol with `arguments`.

    Attributes:
        method: Name of the method.
        arguments: Arguments by name.
        sent: Time of sending, s of the monotonic clock of the daemon's machine; None if a delay does not matter.
        token: Token of a request that acts, holds or releases; None for others.
        latch: True if a request that holds also latches the device; False if it only ends a motion.
    """

    method: str
    arguments: dict[str, Any] = {}
    sent: float | None = None
    token: ActToken | None = None
    latch: bool = True


class DeviceReply(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A device node's answer: a result, or the reason of the failure.

    Attributes:
        result: Result of the method as plain data.
        failure: Reason of the failure; None for a result.
        gate: State of an acting device's gate after the request.
    """

    result: Any = None
    failure: Reason | None = None
    gate: GateState | None = None


class DeviceEvent(Message, frozen=True, kw_only=True, omit_defaults=False):
    """An event that a device reports by itself.

    Attributes:
        device: Name of the device.
        code: Stable code that programs may match on.
        text: One or two sentences for people.
        danger: True for a danger, which takes the lane of Stop.
        fields: Values in the text, as data.
    """

    device: str
    code: str
    text: str
    danger: bool = False
    fields: dict[str, Any] = {}


class Beat(Message, frozen=True, kw_only=True):
    """A heartbeat of the daemon for the device nodes.

    Attributes:
        number: Number that grows with each heartbeat of a session.
        session: Session of the daemon: random, one for each start.
        alive: Last sign of life of the daemon's loop, s of its machine's monotonic clock.
        sent: Time of sending on the same clock, s; it may be long after `alive`.
    """

    number: int
    session: str
    alive: float
    sent: float


class NodeBeat(Message, frozen=True, kw_only=True):
    """A heartbeat of a device's node.

    Attributes:
        number: Number that grows by one each time.
        sent: Time of sending, s of the node's monotonic clock.
        gate: State of an acting device's gate; None for others.
    """

    number: int
    sent: float
    gate: GateState | None = None


class DeviceHealth(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Health of a device, as its node reports it.

    Attributes:
        device: Name of the device.
        connected: True if the device is connected.
        text: Reason why it is not, and what to do.
        dropped: Number of messages that arrived at the node too late since its start, by kind.
    """

    device: str
    connected: bool
    text: str = ""
    dropped: dict[str, int] = {}
