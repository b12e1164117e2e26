"""What a motor evoked potential is told from.

What a hot-spot search is told, what it is given, and how it stands: the same for every method.

What a threshold hunt is told, what it is given, and how it stands: the same for every method.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pcmrs.messages import PoseMessage

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Count = Annotated[int, msgspec.Meta(ge=1)]
HotspotMethod = Literal["adaptive", "grid"]


MOST_POSES = 1000
"""Places with headings: more would take an adaptive search too long from pulse to pulse."""


class HotspotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where and how a hot-spot is searched for.

    Attributes:
        method: ``adaptive``, each pulse where it tells most; or ``grid``, every place in order, then every heading.
        spacing_mm: Between neighbouring places, along the scalp.
        rings: Of the hexagonal grid around the centre: 3 are 37 places, up to 21 mm away.
        heading_reach_deg: How far the handle is turned from its direction at the centre, either way;
        heading_step_deg: in such steps.
        pulses_per_place: At every pose that is asked for.
        response_uv: Least peak-to-peak amplitude of a response; without any there is no hot-spot.
        prior_mm: ``adaptive``: how far from the centre a hot-spot is expected, standard deviation along each axis;
        prior_deg: and how far its handle is turned. Wider than the 8 mm and 18 degrees of the simulated subjects.
        min_pulses: ``adaptive`` does not end before.
        max_pulses: ``adaptive`` ends then at the latest.
        uncertainty_mm: ``adaptive`` ends when the place is known as well as this, rms.

    Raises:
        ValueError: There are too many poses to search, or fewer pulses at most than at least.
    """

    method: HotspotMethod = "adaptive"
    spacing_mm: Positive = 7.0
    rings: Annotated[int, msgspec.Meta(ge=1, le=6)] = 3
    heading_reach_deg: Annotated[float, msgspec.Meta(ge=0.0, le=90.0)] = 45.0
    heading_step_deg: Annotated[float, msgspec.Meta(ge=5.0)] = 15.0
    pulses_per_place: Count = 1
    response_uv: Positive = 50.0
    prior_mm: Positive = 12.0
    prior_deg: Positive = 30.0
    min_pulses: Count = 20
    max_pulses: Annotated[int, msgspec.Meta(ge=1, le=500)] = 60
    uncertainty_mm: Positive = 3.5

    @property
    def turns(self) -> int:
        """Headings to either side of the one at the centre."""
        return int(self.heading_reach_deg / self.heading_step_deg + 1e-9)

    def __post_init__(self) -> None:
        poses = (1 + 3 * self.rings * (self.rings + 1)) * (1 + 2 * self.turns)
        if poses > MOST_POSES:
            raise ValueError(f"there are {poses} places with headings, but {MOST_POSES} at most are searched in time")
        if self.min_pulses > self.max_pulses:
            raise ValueError(f"min_pulses is {self.min_pulses}, but max_pulses is only {self.max_pulses}")


class MapPulse(msgspec.Struct, frozen=True):
    """One pulse of a map.

    Attributes:
        image_from_coil: Of the coil as it was measured.
        amplitude: Peak-to-peak, V.
    """

    image_from_coil: PoseMessage
    amplitude: float


class Hotspot(msgspec.Struct, frozen=True):
    """Where the hot-spot is, as far as is known.

    Attributes:
        image_from_coil: On the scalp, with the handle turned as is best.
        uncertainty: Of its place, rms, m.
        heading_uncertainty: Of the handle's angle about the normal, rms, rad; None where the method states none.
    """

    image_from_coil: PoseMessage
    uncertainty: float
    heading_uncertainty: float | None = None


Percent = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]
"""Of the maximum stimulator output."""
ThresholdMethod = Literal["ml", "relative_frequency"]


class ThresholdSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a motor threshold is searched for; intensities in percent of the maximum stimulator output, whole ones.

    Attributes:
        method: ``ml``, maximum likelihood, or ``relative_frequency``, 5 of 10.
        ceiling: No pulse is asked for or taken above it.
        floor: A threshold that is not above it is not believed: something else than the muscle answers.
        max_pulses: A hunt that has not ended by then is refused.
        response_uv: Least peak-to-peak amplitude of a response: 50 at rest, Rossini et al. 2015.
        noise_uv: Of an amplitude below it no more is believed than that it is below: more than the peak-to-peak noise
            of the measurement.
        prior_mean: ``ml``: where the threshold is expected, and the first pulse goes;
        prior_sd: its standard deviation, wider than the spread of published groups: 52 ± 8 and 66 ± 9.
        interval: ``ml`` ends when the interval of 95 % is narrower than this share of the threshold.
        start: ``relative_frequency``: first intensity, Rossini et al. 2015.

    Raises:
        ValueError: Floor or start lie above the ceiling, or the noise is no less than a response.
    """

    method: ThresholdMethod = "ml"
    ceiling: Percent = 100.0
    floor: Annotated[float, msgspec.Meta(ge=1.0, le=100.0)] = 10.0
    max_pulses: Annotated[int, msgspec.Meta(ge=1)] = 150
    response_uv: Positive = 50.0
    noise_uv: Positive = 25.0
    prior_mean: Percent = 60.0
    prior_sd: Positive = 15.0
    interval: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.08
    start: Percent = 35.0

    def __post_init__(self) -> None:
        if not self.floor < self.ceiling:
            raise ValueError(f"floor is {self.floor:g} %, but ceiling is only {self.ceiling:g} %")
        if not self.noise_uv < self.response_uv:
            raise ValueError(f"noise_uv is {self.noise_uv:g}, but response_uv is only {self.response_uv:g}")


class Pulse(msgspec.Struct, frozen=True):
    """One pulse of a hunt.

    Attributes:
        intensity: Percent of the maximum stimulator output.
        amplitude: Peak-to-peak, V; None where only the answer is known.
    """

    intensity: float
    responded: bool
    amplitude: float | None = None


class Estimate(msgspec.Struct, frozen=True):
    """A motor threshold, percent of the maximum stimulator output.

    Attributes:
        threshold: Until the hunt has finished, what is best at the moment.
        low: Lower end of the interval that holds it with a probability of 95 %; None where the method states none.
        high: Its upper end.
    """

    threshold: float
    low: float | None = None
    high: float | None = None


class EstimatorState(msgspec.Struct, frozen=True):
    """How a hunt stands after its pulses.

    Attributes:
        intensity: Of the next pulse.
        refusal: Why there is no threshold to be found; None while there may be one.
    """

    estimate: Estimate
    intensity: float
    finished: bool = False
    refusal: str | None = None


class MepSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a response is looked for, and when a measurement cannot be used; for a muscle of the hand at rest.

    Attributes:
        window_start: A response comes no earlier after the pulse, s;
        window_end: and no later.
        baseline_start: The muscle is judged at rest from here, s before the pulse: negative;
        baseline_end: until here.
        threshold_uv: Least peak-to-peak amplitude of a response: Rossini et al., Clin. Neurophysiol. 126 (2015) 1071.
        preactivation_uv: A muscle with more root mean square activity than this before the pulse is not at rest: the
            usual limit, which is not strict.
        artefact_uv: If the mean of the signal is still this far from its baseline just before the window, where no
            response can be yet, the stimulus reaches into the window.
        artefact_time: How long before the window that mean is taken, s.
        mains_hz: Frequency of the mains, whose hum is taken out; 0 for none.

    Raises:
        ValueError: The baseline does not end before the pulse, or the window does not begin after it.
    """

    window_start: Positive = 0.015
    window_end: Positive = 0.050
    baseline_start: float = -0.105
    baseline_end: float = -0.005
    threshold_uv: Positive = 50.0
    preactivation_uv: Positive = 10.0
    artefact_uv: Positive = 15.0
    artefact_time: Positive = 0.003
    mains_hz: Annotated[float, msgspec.Meta(ge=0.0, le=70.0)] = 50.0

    def __post_init__(self) -> None:
        if not self.baseline_start < self.baseline_end <= 0.0:
            raise ValueError("baseline_start must be before baseline_end, and that not after the pulse")
        if not self.artefact_time <= self.window_start < self.window_end:
            raise ValueError("window_start must be before window_end, and artefact_time fit between pulse and window")
