"""Poses, frames and text as messages of Foxglove, which Foxglove and Rerun can show."""

from __future__ import annotations

import math
from typing import Any, Final

import msgspec
from foxglove.messages import (
    FrameTransform,
    FrameTransforms,
    JointState,
    JointStates,
    Log,
    LogLevel,
    Pose,
    PoseInFrame,
    Quaternion,
    Timestamp,
    Vector3,
)

from pcmrs.messages import Message
from pcmrs.messages.setup import ProcedureDataView
from pcmrs.spatial import Transform

FoxgloveView = FrameTransforms | JointStates | Log | PoseInFrame | Message
"""Message of a topic for people; a `Message` is written as JSON."""

_SECOND = 1_000_000_000
_SCHEMA_NAMES: Final[dict[type[Message], str]] = {ProcedureDataView: "Gathered"}
"""Schema names that differ from the class: recordings keep them, since other programs select topics by schema."""


def stamp(at_ns: int) -> Timestamp:
    """Return a time, ns since 1970, as seconds and nanoseconds; 0 if it is earlier: the clock may not be set yet."""
    seconds, nanoseconds = divmod(max(at_ns, 0), _SECOND)
    return Timestamp(seconds, nanoseconds)


def link(parent: str, child: str, parent_from_child: Transform, at_ns: int) -> FrameTransforms:
    """Return a link between two frames.

    Args:
        parent: Parent frame.
        child: Child frame.
        parent_from_child: Pose of the child in the parent frame.
        at_ns: Time of the pose, ns since 1970.
    """
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp(at_ns),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(parent_from_child),
                rotation=_quaternion(parent_from_child),
            )
        ]
    )


def pose_in(frame: str, pose: Transform, at_ns: int) -> PoseInFrame:
    """Return a pose in a frame.

    Args:
        frame: Frame.
        pose: Pose in that frame.
        at_ns: Time of the pose, ns since 1970.
    """
    shown = Pose(position=_vector(pose), orientation=_quaternion(pose))
    return PoseInFrame(timestamp=stamp(at_ns), frame_id=frame, pose=shown)


def joints(names: list[str], positions: list[float], velocities: list[float], at_ns: int) -> JointStates:
    """Return the states of the joints.

    Args:
        names: Names of the joints.
        positions: Positions, rad, one for each name.
        velocities: Velocities, rad/s, one for each name.
        at_ns: Time of the measurement, ns since 1970.
    """
    each = [
        JointState(name=name, position=position, velocity=velocity)
        for name, position, velocity in zip(names, positions, velocities, strict=True)
    ]
    return JointStates(timestamp=stamp(at_ns), joints=each)


def line(level: LogLevel, name: str, text: str, at_ns: int) -> Log:
    """Return a line of the log.

    Args:
        level: Level.
        name: Source of the line.
        text: Text.
        at_ns: Time, ns since 1970.
    """
    return Log(timestamp=stamp(at_ns), level=level, name=name, message=text)


def json_schema(kind: type[Message]) -> dict[str, Any]:
    """Return the JSON schema of a type of messages in the subset that Foxglove supports.

    Foxglove does not show a topic whose schema has references, choices, tuples, maps, or lists of lists. So an optional
    field is described without null and is missing from a message (see `json_bytes`), a tuple is described as a list, a
    map as an object without fields, and a list of lists is left out.
    """
    whole = msgspec.json.schema(kind)
    schema: dict[str, Any] = _plain(whole, whole["$defs"])
    return {**schema, "title": f"pcmrs.{_SCHEMA_NAMES.get(kind, kind.__name__)}"}


def json_bytes(message: Message) -> bytes:
    """Return a message as JSON. Fields without a value are left out, since `json_schema` describes none as null."""
    return msgspec.json.encode(_without_null(msgspec.to_builtins(message)))


def _without_null(value: Any) -> Any:
    """Return a value without the fields that would be null: None, and numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _without_null(each) for key, each in value.items() if not _is_null(each)}
    return [_without_null(each) for each in value] if isinstance(value, list | tuple) else value


def _is_null(value: Any) -> bool:
    return value is None or (isinstance(value, float) and not math.isfinite(value))


def _plain(schema: dict[str, Any], parts: dict[str, Any]) -> Any:
    """Return a schema in Foxglove's subset (see `json_schema`); None if it cannot be expressed."""
    if "$ref" in schema:
        return _plain(parts[schema["$ref"].rpartition("/")[2]], parts)
    if "anyOf" in schema:
        return _plain(next(each for each in schema["anyOf"] if each.get("type") != "null"), parts)
    notes: dict[str, Any] = {key: schema[key] for key in ("title", "description") if key in schema}
    if "enum" in schema:
        return {**notes, "type": "string", "enum": schema["enum"]}
    if schema.get("type") == "object":
        fields = {name: _plain(each, parts) for name, each in schema.get("properties", {}).items()}
        return {**notes, "type": "object", "properties": {name: each for name, each in fields.items() if each}}
    if schema.get("type") == "array":
        item = _plain((schema.get("prefixItems") or [schema.get("items", {})])[0], parts)
        return None if item is None or item["type"] == "array" else {**notes, "type": "array", "items": item}
    return {**notes, "type": schema["type"]} if "type" in schema else None


def _vector(transform: Transform) -> Vector3:
    x, y, z = transform.translation.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(transform: Transform) -> Quaternion:
    w, x, y, z = transform.quat_wxyz.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)
