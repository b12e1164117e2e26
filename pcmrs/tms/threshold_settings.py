"""What a threshold hunt is told, what it is given, and how it stands: the same for every method."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Percent = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]
"""Of the maximum stimulator output."""
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
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


class Standing(msgspec.Struct, frozen=True):
    """How a hunt stands after its pulses.

    Attributes:
        intensity: Of the next pulse.
        refusal: Why there is no threshold to be found; None while there may be one.
    """

    estimate: Estimate
    intensity: float
    finished: bool = False
    refusal: str | None = None
