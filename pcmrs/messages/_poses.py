"""Poses, tracked and planned, and the prompt for a person with a pointer."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.messages._base import Message


class LandmarkPrompt(Message, frozen=True, kw_only=True):
    """Prompt to touch one landmark with the pointer.

    Attributes:
        index: Index of the landmark in the plan, from 0.
        name: Name of the landmark.
        position_in_image: Planned position, which the screen shows, m.
    """

    index: int
    name: str
    position_in_image: tuple[float, float, float]


class Beeps(Message, frozen=True, kw_only=True):
    """Beeps that the tracker sounds for the person with the pointer.

    Attributes:
        count: Number of beeps, 1 to 9.
    """

    count: Annotated[int, msgspec.Meta(ge=1, le=9)]


class BodyPose(Message, frozen=True, kw_only=True):
    """One tracked body in one tracker frame, as the tracker measured it.

    Attributes:
        body: Name of the tracked body.
        frame_number: Number that grows by one per tracker frame; a frozen number is a frozen tracker.
        captured: Time of the exposure, s of the sender's monotonic clock.
        sent: Time of publication, s of the sender's monotonic clock.
        valid: False if the tracker does not see the body; `reason` says why.
        position: Translation of ``tracker_from_body``, m.
        quat_wxyz: Rotation of ``tracker_from_body``, unit quaternion.
        error: Fit error reported by the tracker, m.
        reason: Reason why the pose is not valid.
        session: Random id, new for each start of the tracker's node and each restart of the tracker's count. Frame
            numbers and time stamps are comparable within one session only. The node sets it.
    """

    body: str
    frame_number: int
    captured: float
    sent: float
    valid: bool
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    error: float = 0.0
    reason: str | None = None
    session: str = ""


class PoseMessage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A pose as data.

    Attributes:
        position: Translation, m.
        quat_wxyz: Rotation, unit quaternion.
    """

    position: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]


class Target(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Planned pose of the tool, and the registration of the image to the patient.

    Attributes:
        plan: Id of the accepted tool plan; None if there is none.
        pose: Planned ``image_from_coil``; None if there is none.
        body_ref_from_image: Registration in force; None if there is none.
    """

    plan: str | None = None
    pose: PoseMessage | None = None
    body_ref_from_image: PoseMessage | None = None
