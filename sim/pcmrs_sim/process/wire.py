"""Messages between a node and its simulated world: MessagePack behind a length of four bytes."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs import errors
from pcmrs.devices.framing import framed
from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.messages import Beat, BodyPose, DeviceEvent, JointSetpoint, JointState

_ERRORS = {name: kind for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, PcmrsError)}


class Failure(msgspec.Struct, frozen=True, array_like=True):
    """An error that was raised at the other end.

    Attributes:
        kind: Name of its class in `pcmrs.errors`.
        text: Text of the error.
        fields: Fields of the error, as plain data.
    """

    kind: str
    text: str
    fields: dict[str, Any]

    @classmethod
    def of(cls, error: PcmrsError) -> Failure:
        """Return the message of an error."""
        return cls(type(error).__name__, error.text, error.fields)

    def error(self) -> PcmrsError:
        """Return the error; an `UnknownOutcomeError` if its class is unknown here."""
        return _ERRORS.get(self.kind, UnknownOutcomeError)(self.text, **self.fields)


class Open(msgspec.Struct, frozen=True, tag="open"):
    """Request to open the cell: the first message of the node.

    Attributes:
        devices: Names of the devices that the node serves.
        settings: The whole configuration.
    """

    devices: list[str]
    settings: dict[str, Any]


class Call(msgspec.Struct, frozen=True, tag="call"):
    """Call of a method of a device.

    Attributes:
        number: Number of the call, which its reply repeats.
        device: Name of the device.
        method: Name of the method in its protocol.
        arguments: Arguments by name, as plain data.
        sent: Time of sending on the machine's monotonic clock, s.
    """

    number: int
    device: str
    method: str
    arguments: dict[str, Any]
    sent: float


class Cancel(msgspec.Struct, frozen=True, tag="cancel"):
    """Cancellation of a call by its number: its caller was cancelled."""

    number: int


class ServoPoint(msgspec.Struct, frozen=True, tag="point"):
    """A set point of the running servo session."""

    setpoint: JointSetpoint


class Alive(msgspec.Struct, frozen=True, tag="alive"):
    """Heartbeat of the node's event loop."""

    beat: Beat


class Opened(msgspec.Struct, frozen=True, tag="opened"):
    """Reply to `Open`, with the failure if the cell does not run: the first message of the world."""

    failure: Failure | None = None


class Reply(msgspec.Struct, frozen=True, tag="reply"):
    """Result or failure of a call.

    Attributes:
        number: Number of the call.
        result: Result, as plain data.
        failure: The error, if it failed.
    """

    number: int
    result: Any = None
    failure: Failure | None = None


class TrackerPoses(msgspec.Struct, frozen=True, tag="frame"):
    """Poses of all bodies in one frame of the tracker."""

    poses: list[BodyPose]


class ArmState(msgspec.Struct, frozen=True, tag="state"):
    """Measured joints, and the number of set points that the arm has dropped so far."""

    state: JointState
    dropped: int = 0


class WorldEvent(msgspec.Struct, frozen=True, tag="event"):
    """Event of a device."""

    event: DeviceEvent


class Trouble(msgspec.Struct, frozen=True, tag="trouble"):
    """Reason for which a device sends nothing; empty if it sends again."""

    device: str
    text: str


ToWorld = Open | Call | Cancel | ServoPoint | Alive
ToNode = Opened | Reply | TrackerPoses | ArmState | WorldEvent | Trouble

_encoder = msgspec.msgpack.Encoder()
_to_world: msgspec.msgpack.Decoder[ToWorld] = msgspec.msgpack.Decoder(ToWorld)
_to_node: msgspec.msgpack.Decoder[ToNode] = msgspec.msgpack.Decoder(ToNode)


def pack(message: ToWorld | ToNode) -> bytes:
    """Return the bytes of a message, with its length."""
    return framed(_encoder.encode(message))


def read_by_world(body: bytes) -> ToWorld:
    """Return the message of a node, from its bytes without the length."""
    return _to_world.decode(body)


def read_by_node(body: bytes) -> ToNode:
    """Return the message of a world, from its bytes without the length."""
    return _to_node.decode(body)
