"""What a node and its simulated world say to each other: MessagePack behind a length of four bytes."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs import errors
from pcmrs.devices.framing import framed
from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.messages import Beat, BodyPose, DeviceEvent, JointSetpoint, JointState

_ERRORS = {name: kind for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, PcmrsError)}


class Failure(msgspec.Struct, frozen=True, array_like=True):
    """An error, as it was raised at the other end.

    Attributes:
        kind: Name of its class in `pcmrs.errors`.
        text: Of the error.
        fields: Of the error, plain data.
    """

    kind: str
    text: str
    fields: dict[str, Any]

    @classmethod
    def of(cls, error: PcmrsError) -> Failure:
        """The failure that stands for an error."""
        return cls(type(error).__name__, error.text, error.fields)

    def error(self) -> PcmrsError:
        """The error that it stands for; one of an unknown class has an unknown outcome."""
        return _ERRORS.get(self.kind, UnknownOutcomeError)(self.text, **self.fields)


class Open(msgspec.Struct, frozen=True, tag="open"):
    """Opens the cell: the first message of the node.

    Attributes:
        devices: Those that the node serves.
        settings: The whole configuration.
    """

    devices: list[str]
    settings: dict[str, Any]


class Call(msgspec.Struct, frozen=True, tag="call"):
    """Calls a method of a device.

    Attributes:
        number: Of the call, which its reply names.
        device: Its name.
        method: Of its protocol.
        arguments: By name.
        sent: s of the machine's monotonic clock.
    """

    number: int
    device: str
    method: str
    arguments: dict[str, Any]
    sent: float


class Cancel(msgspec.Struct, frozen=True, tag="cancel"):
    """Nobody waits for the end of a call any more."""

    number: int


class ServoPoint(msgspec.Struct, frozen=True, tag="point"):
    """A set point of the running servo session."""

    setpoint: JointSetpoint


class Alive(msgspec.Struct, frozen=True, tag="alive"):
    """A sign of life of the node's event loop."""

    beat: Beat


class Opened(msgspec.Struct, frozen=True, tag="opened"):
    """The cell runs, or why it does not: the first message of the world."""

    failure: Failure | None = None


class Reply(msgspec.Struct, frozen=True, tag="reply"):
    """The end of a call."""

    number: int
    result: Any = None
    failure: Failure | None = None


class TrackerPoses(msgspec.Struct, frozen=True, tag="frame"):
    """All bodies of one frame of the tracker."""

    poses: list[BodyPose]


class ArmState(msgspec.Struct, frozen=True, tag="state"):
    """Measured joints, and how many set points the arm has dropped until then."""

    state: JointState
    dropped: int = 0


class Event(msgspec.Struct, frozen=True, tag="event"):
    """What a device reports by itself."""

    event: DeviceEvent


class Trouble(msgspec.Struct, frozen=True, tag="trouble"):
    """Why a device sends nothing; empty while it does."""

    device: str
    text: str


ToWorld = Open | Call | Cancel | ServoPoint | Alive
ToNode = Opened | Reply | TrackerPoses | ArmState | Event | Trouble

_encoder = msgspec.msgpack.Encoder()
_to_world: msgspec.msgpack.Decoder[ToWorld] = msgspec.msgpack.Decoder(ToWorld)
_to_node: msgspec.msgpack.Decoder[ToNode] = msgspec.msgpack.Decoder(ToNode)


def pack(message: ToWorld | ToNode) -> bytes:
    """The message with its length."""
    return framed(_encoder.encode(message))


def read_by_world(body: bytes) -> ToWorld:
    """The message of a node."""
    return _to_world.decode(body)


def read_by_node(body: bytes) -> ToNode:
    """The message of a world."""
    return _to_node.decode(body)
