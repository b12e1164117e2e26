"""Poses, tracked and planned.

What a person with a pointer is asked.
"""

from __future__ import annotations

from pcmrs.messages.base import Message


class LandmarkPrompt(Message, frozen=True, kw_only=True):
    """Asks the person with the pointer to touch one landmark.

    Attributes:
        index: From 0, in the order of the plan.
        position_in_image: Where the plan has it, m: what the person sees on the screen.
    """

    index: int
    name: str
    position_in_image: tuple[float, float, float]


class BodyPose(Message, frozen=True, kw_only=True):
    """One tracked body in one tracker frame, as the tracker measured it.

    Attributes:
        frame_number: Grows by one per tracker frame; a frozen number is a frozen tracker.
        captured: Sender's monotonic time of the exposure.
        sent: Sender's monotonic time of publication.
        valid: False when the tracker does not see the body; then `reason` says why.
        position: `tracker_from_body` translation, m.
        quat_wxyz: `tracker_from_body` rotation, unit quaternion.
        error: The tracker's own fit error, m.
        reason: Why it is not valid.
        session: Random id, one per start of the tracker's node and whenever the tracker counts anew; numbers and stamps
            are compared within one session only. The node sets it.
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
    """A pose as data: translation in m and unit ``quat_wxyz``."""

    position: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]


class Target(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Where the tool shall be, and what joins the image to the patient.

    Attributes:
        plan: Id of the accepted tool plan; None when there is none.
        pose: Its ``image_from_coil``; None when there is none.
        body_ref_from_image: The registration in force; None when there is none.
    """

    plan: str | None = None
    pose: PoseMessage | None = None
    body_ref_from_image: PoseMessage | None = None
