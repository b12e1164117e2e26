"""What a hot-spot search is told, what it is given, and how it stands: the same for every method."""

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
