"""Calls to device nodes, and what these tell of themselves."""

from __future__ import annotations

from typing import Any

from pcmrs.messages.base import Message
from pcmrs.messages.decisions import Reason


class DeviceRequest(Message, frozen=True, kw_only=True):
    """A call to a device node: `method` of its protocol with `arguments`.

    Attributes:
        method: Its name.
        arguments: By name.
        sent: When the daemon sent it, s of its machine's monotonic clock; None where nobody minds that it is late.
    """

    method: str
    arguments: dict[str, Any] = {}
    sent: float | None = None


class DeviceReply(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A device node's answer: a result, or the reason of the failure."""

    result: Any = None
    failure: Reason | None = None


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
    """A heartbeat of a device node; `number` grows by one each time, `sent` is s of its machine's monotonic clock."""

    number: int
    sent: float


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
