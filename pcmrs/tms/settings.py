"""Data of the TMS methods: settings, pulses and results of MEP detection, hot-spot search and threshold hunt.

They are the same for every method of a search or a hunt.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pcmrs.messages import PoseMessage

__all__ = [
    "Estimate",
    "EstimatorState",
    "Hotspot",
    "HotspotMethod",
    "HotspotSettings",
    "MapPulse",
    "MepSettings",
    "Pulse",
    "ThresholdMethod",
    "ThresholdSettings",
]

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Count = Annotated[int, msgspec.Meta(ge=1)]
HotspotMethod = Literal["adaptive", "grid"]
"""Order of the pulses of a search: each where it is expected to say most, or one place of the grid after the other."""


MAX_POSES = 1000
"""Greatest number of places times headings. With more, an adaptive search would take too long between pulses."""


class HotspotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Region and method of a hot-spot search.

    Attributes:
        method: ``adaptive``, each pulse where it tells most; or ``grid``, every place in order, then every heading.
        spacing_mm: Distance between neighbouring places along the scalp, mm.
        rings: Number of rings of the hexagonal grid around the centre: 3 rings are 37 places, up to 21 mm away.
        heading_reach_deg: Greatest turn of the handle from its direction at the centre, either way, deg.
        heading_step_deg: Step of these turns, deg.
        pulses_per_place: Number of pulses at every requested pose.
        response_uv: Least peak-to-peak amplitude of a response, uV. Without any response there is no hot-spot.
        prior_mm: ``adaptive``: standard deviation of the hot-spot from the centre along each axis, mm.
        prior_deg: ``adaptive``: standard deviation of its handle's turn, deg. Both are wider than the 8 mm and 18 deg
            of the simulated subjects.
        min_pulses: Number of pulses before which ``adaptive`` does not end.
        max_pulses: Number of pulses at which ``adaptive`` ends at the latest.
        uncertainty_mm: Rms uncertainty of the place at which ``adaptive`` ends, mm.

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
        """Number of headings to either side of the one at the centre."""
        return int(self.heading_reach_deg / self.heading_step_deg + 1e-9)

    def __post_init__(self) -> None:
        poses = (1 + 3 * self.rings * (self.rings + 1)) * (1 + 2 * self.turns)
        if poses > MAX_POSES:
            raise ValueError(f"there are {poses} places with headings, but {MAX_POSES} at most are searched in time")
        if self.min_pulses > self.max_pulses:
            raise ValueError(f"min_pulses is {self.min_pulses}, but max_pulses is only {self.max_pulses}")


class MapPulse(msgspec.Struct, frozen=True):
    """One pulse of a map.

    Attributes:
        image_from_coil: Measured pose of the coil.
        amplitude: Peak-to-peak amplitude, V.
    """

    image_from_coil: PoseMessage
    amplitude: float


class Hotspot(msgspec.Struct, frozen=True):
    """Estimated hot-spot.

    Attributes:
        image_from_coil: Pose of the coil on the scalp with the best heading.
        uncertainty: Rms uncertainty of its place, m.
        heading_uncertainty: Rms uncertainty of the heading, rad; None if the method gives none.
    """

    image_from_coil: PoseMessage
    uncertainty: float
    heading_uncertainty: float | None = None


Percent = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]
"""Intensity in percent of the maximum stimulator output."""
ThresholdMethod = Literal["ml", "relative_frequency"]
"""Estimator of the motor threshold: maximum likelihood, or relative frequency."""


class ThresholdSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a hunt for a motor threshold. Intensities are whole percent of the maximum stimulator output.

    Attributes:
        method: ``ml``, maximum likelihood, or ``relative_frequency``, 5 of 10.
        ceiling: Greatest intensity of a pulse.
        floor: Limit for implausible thresholds. At or below it, something else than the muscle responds.
        max_pulses: Number of pulses after which a hunt that has not ended is refused.
        response_uv: Least peak-to-peak amplitude of a response, uV: 50 at rest (Rossini et al. 2015).
        noise_uv: Amplitude below which a value only counts as below, uV: more than the peak-to-peak noise of the
            measurement.
        prior_mean: ``ml``: expected threshold and intensity of the first pulse.
        prior_sd: ``ml``: standard deviation of the threshold, wider than that of published groups: 52 ± 8 and 66 ± 9.
        interval: ``ml``: share of the threshold below which the width of the interval of 95 % ends the hunt.
        start: ``relative_frequency``: first intensity (Rossini et al. 2015).

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
        intensity: Intensity, percent of the maximum stimulator output.
        responded: True if the muscle responded.
        amplitude: Peak-to-peak amplitude, V; None if only the response is known.
    """

    intensity: float
    responded: bool
    amplitude: float | None = None


class Estimate(msgspec.Struct, frozen=True):
    """A motor threshold, percent of the maximum stimulator output.

    Attributes:
        threshold: Threshold; until the hunt has finished, the best present estimate.
        low: Lower end of the interval that holds it with a probability of 95 %; None if the method gives none.
        high: Upper end of that interval; None if the method gives none.
    """

    threshold: float
    low: float | None = None
    high: float | None = None


class EstimatorState(msgspec.Struct, frozen=True):
    """State of a hunt after its pulses.

    Attributes:
        estimate: Estimated threshold.
        intensity: Intensity of the next pulse, percent of the maximum stimulator output.
        finished: True if the threshold is known well enough.
        refusal: Code of the reason why no threshold can be found; None while one may be found.
    """

    estimate: Estimate
    intensity: float
    finished: bool = False
    refusal: str | None = None


class MepSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Window of a response and limits of a valid measurement, for a muscle of the hand at rest.

    Attributes:
        window_start: Earliest time of a response after the pulse, s.
        window_end: Latest time of a response after the pulse, s.
        baseline_start: Start of the baseline, in which the muscle must be at rest, s since the pulse (negative).
        baseline_end: End of the baseline, s since the pulse.
        threshold_uv: Least peak-to-peak amplitude of a response, uV (Rossini et al., Clin. Neurophysiol. 126 (2015)
            1071).
        preactivation_uv: Greatest root mean square activity before the pulse of a muscle at rest, uV: the usual limit,
            which is not strict.
        artefact_uv: Greatest distance of the signal's mean from the baseline just before the window, uV. A larger one
            is the stimulus artefact, because no response can have begun.
        artefact_time: Duration before the window over which that mean is computed, s.
        mains_hz: Frequency of the mains, whose hum is removed, Hz; 0 for none.

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
