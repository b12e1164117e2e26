"""Ground truth of a simulated scene, and motion of its head."""

from __future__ import annotations

from pcmrs.messages._base import Message
from pcmrs.messages._poses import PoseMessage


class SceneTruth(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Ground truth of a simulated scene: for reports and tests, never for control.

    The true pose of a planned tool is ``tracker_from_body_ref @ body_ref_from_image @ image_from_coil``.

    Attributes:
        tracker_from_coil: True pose of the tool's contact point.
        tracker_from_body_ref: True pose of the reference on the body.
        body_ref_from_image: True registration.
        time: Time of the cell at which all values hold, s.
        contact_force: Force between body and tool, N.
        tip_in_pointer: True position of the tip in the pointer's marker body, m.
        tip_in_tracker: Present position of the tip, m; None while the pointer is away.
        image_from_hotspot: Best pose of the stimulator's coil; None if there is nothing to stimulate.
        threshold: Motor threshold at that pose, percent of the maximum stimulator output; None likewise.
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
    """A sudden shift of the head.

    Attributes:
        time: Time after the start of the motion, s of the cell.
        offset: Shift along the tracker's axes, m.
    """

    time: float
    offset: tuple[float, float, float]


class HeadBurst(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A quick motion of the head, which then stays where it is.

    Attributes:
        time: Time after the start of the motion, s of the cell.
        duration: Duration, s.
        speed: Speed, m/s.
        direction: Unit vector along the tracker's axes.
    """

    time: float
    duration: float
    speed: float
    direction: tuple[float, float, float]


class HeadMotion(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Motion of a simulated head, in cell time since it was set; by default there is none.

    Vectors are along the tracker's axes.

    Attributes:
        drift: Constant velocity, m/s.
        breathing_amplitude: Amplitude of a sine along `breathing_direction`, m.
        breathing_hz: Frequency of the sine, Hz.
        breathing_direction: Unit vector.
        steps: Sudden shifts.
        bursts: Quick motions.
        seed: Seed of the phase of the breathing.
    """

    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    breathing_amplitude: float = 0.0
    breathing_hz: float = 0.25
    breathing_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    steps: list[HeadStep] = []
    bursts: list[HeadBurst] = []
    seed: int = 0
