"""The truth of a simulated scene, and how its head moves."""

from __future__ import annotations

from pcmrs.messages.base import Message
from pcmrs.messages.poses import PoseMessage


class SceneTruth(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Ground truth of a simulated scene: for reports and tests, never for control.

    The true pose of a planned tool is ``tracker_from_body_ref @ body_ref_from_image @ image_from_coil``.

    Attributes:
        time: Of the cell, at which all of it holds, s.
        contact_force: Between body and tool, N.
        tip_in_pointer: Where the pointer's tip truly is, in its marker body, m.
        tip_in_tracker: Where it is now, m; None while the pointer is away.
        image_from_hotspot: Best pose of a stimulator's coil; None where there is nothing to stimulate.
        threshold: Motor threshold there, percent of the maximum stimulator output; None likewise.
    """

    tracker_from_coil: PoseMessage
    tracker_from_body_ref: PoseMessage
    body_ref_from_image: PoseMessage
    time: float = 0.0
    contact_force: float = 0.0
    tip_in_pointer: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tip_in_tracker: tuple[float, float, float] | None = None
    image_from_hotspot: PoseMessage | None = None
    threshold: float | None = None


class HeadStep(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A quick shift of the head by `offset` (m, along the tracker's axes), `time` s after the motion began."""

    time: float
    offset: tuple[float, float, float]


class HeadBurst(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The head goes at `speed` (m/s) for `duration` (s) along `direction` (unit vector), and stays there."""

    time: float
    duration: float
    speed: float
    direction: tuple[float, float, float]


class HeadMotion(Message, frozen=True, kw_only=True, omit_defaults=False):
    """How a simulated head moves, in cell time since it was set; by default it does not.

    Vectors are along the tracker's axes.

    Attributes:
        drift: Velocity, m/s.
        breathing_amplitude: Of a sine along `breathing_direction`, m.
        breathing_hz: Its frequency.
        breathing_direction: Unit vector.
        steps: Sudden shifts.
        bursts: Stretches of quick motion.
        seed: Gives the breathing its phase.
    """

    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    breathing_amplitude: float = 0.0
    breathing_hz: float = 0.25
    breathing_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    steps: list[HeadStep] = []
    bursts: list[HeadBurst] = []
    seed: int = 0
