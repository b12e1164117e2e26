"""Standard messages of ROS 2, and their bytes.

Fields and their order are those of the packages builtin_interfaces, std_msgs, geometry_msgs, sensor_msgs and tf2_msgs.
Bytes are plain CDR with its header of four bytes (DDS-RTPS 2.5, 10.2; DDS-XTypes 1.3, 7.4.3), as every DDS of ROS 2
sends them. The library resolves annotations at run time, so they must not be strings here.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, TypeVar

from pycdr2 import IdlStruct
from pycdr2.types import float64, int32, sequence, uint32

from pcmrs.errors import PayloadError
from pcmrs.spatial import Transform

__all__ = [
    "Header",
    "Point",
    "Pose",
    "PoseStamped",
    "Quaternion",
    "RigidTransform",
    "RosJointState",
    "String",
    "TFMessage",
    "Time",
    "TransformStamped",
    "Vector3",
    "decode",
    "header",
    "link",
    "pose_stamped",
]

MAX_BYTES: Final = 4096
"""Longest accepted message; the longest of those received here has less than 400 bytes."""

_PLAIN: Final = (b"\x00\x00", b"\x00\x01")
"""First bytes of plain CDR, big-endian and little-endian."""
_PADDING: Final = 3
"""Bytes with which a sender may fill the last word."""

M = TypeVar("M", bound=IdlStruct)


@dataclass
class Time(IdlStruct, typename="builtin_interfaces/msg/Time"):
    """A moment on the wall clock, since 1970."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs/msg/Header"):
    """Time and frame of a message."""

    stamp: Time
    frame_id: str


@dataclass
class String(IdlStruct, typename="std_msgs/msg/String"):
    """A text."""

    data: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs/msg/Point"):
    """A point, m."""

    x: float64
    y: float64
    z: float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs/msg/Vector3"):
    """A vector; here a translation, m."""

    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs/msg/Quaternion"):
    """A rotation as a unit quaternion, w at the end."""

    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs/msg/Pose"):
    """Position and orientation."""

    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs/msg/PoseStamped"):
    """A pose in the header's frame."""

    header: Header
    pose: Pose


@dataclass
class RigidTransform(IdlStruct, typename="geometry_msgs/msg/Transform"):
    """Translation and rotation."""

    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs/msg/TransformStamped"):
    """Pose of the child frame in the header's frame."""

    header: Header
    child_frame_id: str
    transform: RigidTransform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs/msg/TFMessage"):
    """Any number of frames."""

    transforms: Annotated[Sequence[TransformStamped], sequence(TransformStamped)]


@dataclass
class RosJointState(IdlStruct, typename="sensor_msgs/msg/JointState"):
    """Joints by name: positions in rad, velocities in rad/s, efforts in N m."""

    header: Header
    name: Annotated[Sequence[str], sequence(str)]
    position: Annotated[Sequence[float], sequence(float64)]
    velocity: Annotated[Sequence[float], sequence(float64)]
    effort: Annotated[Sequence[float], sequence(float64)]


def header(frame: str, at: float) -> Header:
    """Return the header of a message.

    Args:
        frame: Frame of the data.
        at: Wall time, Unix s.
    """
    sec = math.floor(at)
    return Header(Time(sec, int((at - sec) * 1e9)), frame)


def pose_stamped(frame: str, pose: Transform, at: float) -> PoseStamped:
    """Return a pose in a frame.

    Args:
        frame: The frame.
        pose: ``frame_from_body``.
        at: Wall time, Unix s.
    """
    return PoseStamped(header(frame, at), Pose(Point(*pose.translation.tolist()), _quaternion(pose)))


def link(parent: str, child: str, parent_from_child: Transform, at: float) -> TransformStamped:
    """Return the pose of one frame in another.

    Args:
        parent: Parent frame.
        child: Child frame.
        parent_from_child: The pose.
        at: Wall time, Unix s.
    """
    moved = RigidTransform(Vector3(*parent_from_child.translation.tolist()), _quaternion(parent_from_child))
    return TransformStamped(header(parent, at), child, moved)


def decode(payload: bytes, kind: type[M]) -> M:
    """Return the message that the bytes hold.

    Args:
        payload: The bytes.
        kind: Type of the message.

    Raises:
        PayloadError: It is too long, not plain CDR, cut off, or longer than this type: it may be of another type.
    """
    name = kind.__name__
    if len(payload) > MAX_BYTES:
        text = f"{len(payload)} bytes are too long for a {name}: at most {MAX_BYTES}."
        raise PayloadError(text, length=len(payload), limit=MAX_BYTES)
    if payload[:2] not in _PLAIN:
        raise PayloadError(f"Not a {name}: it does not begin as plain CDR does; publish {name} of ROS 2.", kind=name)
    try:
        message = kind.deserialize(payload)
        rest = len(payload) - len(message.serialize())
    except (struct.error, ValueError, IndexError, OverflowError, MemoryError) as error:
        raise PayloadError(f"Not a {name}: {error}. Publish {name} of ROS 2.", kind=name) from error
    if not 0 <= rest <= _PADDING:
        raise PayloadError(f"Not a {name}: {rest} bytes are left over; publish {name} of ROS 2.", kind=name)
    return message


def _quaternion(transform: Transform) -> Quaternion:
    w, x, y, z = transform.quat_wxyz.tolist()
    return Quaternion(x, y, z, w)
