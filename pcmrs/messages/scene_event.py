"""Events that detectors recognise in the surgical scene."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final

import msgspec

from pcmrs.messages._base import Message

__all__ = ["BLIND", "WATCHING", "SceneEvent"]

WATCHING: Final = "watching"
"""Label of the event that a source publishes for each frame, after the detections in it: its sign of life."""
BLIND: Final = "blind"
"""Label of the event with which a source reports that it cannot see the scene; `SceneEvent.reason` says why."""

Name = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_.-]{0,62}$")]
Word = Annotated[str, msgspec.Meta(max_length=64)]


class SceneEvent(Message, frozen=True, kw_only=True):
    """One detection in one frame of a source, or a sign of life of the source.

    Attributes:
        source: Name of the detector.
        label: Class of the detected object or action, `WATCHING` or `BLIND`.
        captured: Time of the frame, s of the sender's monotonic clock.
        sent: Time of publication, s of the same clock.
        session: Random id, new for each start of the source: times are comparable within one session only.
        confidence: Confidence of the detection, 0 to 1.
        track: Number of the tracked object; None if the source does not track.
        position: Position of the object in `frame`, m; None if it is not known.
        frame: Name of the coordinate frame of `position`, such as ``robot_base``.
        region: Name of the region in which the object is; empty for none.
        reason: Reason why the source is blind, such as ``occluded``.
        arguments: Values for the operation that the cell's table calls.
    """

    max_bytes: ClassVar[int] = 4096

    source: Name
    label: Name
    captured: float
    sent: float
    session: Word
    confidence: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 1.0
    track: Annotated[int, msgspec.Meta(ge=0)] | None = None
    position: tuple[float, float, float] | None = None
    frame: Word = ""
    region: Word = ""
    reason: Word = ""
    arguments: dict[str, Any] = {}
