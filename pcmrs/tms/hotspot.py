"""Search for the motor hot-spot pulse by pulse, with either method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import msgspec

from pcmrs.errors import RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform
from pcmrs.tms import _adaptive, _mapping
from pcmrs.tms.grid import grid_on_scalp
from pcmrs.tms.scalp import NearestPoints, ScalpPatch, as_message, as_transform, scalp_patch
from pcmrs.tms.settings import Hotspot, HotspotSettings, MapPulse

__all__ = ["HotspotSearch"]

MAX_AMPLITUDE = 0.1
"""Largest plausible amplitude, V: more than ten times that of any muscle."""


class HotspotSearch(msgspec.Struct, frozen=True):
    """State of a search: places for pulses, and the amplitudes evoked there.

    It holds everything that the search depends on, so that it can be journalled and replayed. Start with ``search =
    HotspotSearch.begin(settings, closest, centre)``. Give each pulse at ``search.next()`` and continue with ``search =
    search.after(measured, amplitude)`` until `finished`. All pulses have one intensity.

    Attributes:
        settings: Settings of the search.
        places: ``image_from_coil`` of the places, in the order of the map. The first is the centre.
        pulses: Pulses that count. A pulse whose response cannot be judged is repeated and is not among them.
    """

    settings: HotspotSettings
    places: tuple[PoseMessage, ...]
    pulses: tuple[MapPulse, ...] = ()

    @classmethod
    def begin(cls, settings: HotspotSettings, closest: NearestPoints, centre: Transform) -> Self:
        """Return a search without pulses.

        Args:
            settings: Places and method of the search.
            closest: Query for the nearest points of the scalp. It is needed only here.
            centre: ``image_from_coil`` where the hot-spot is expected. It is moved onto the scalp.

        Raises:
            GeometryError: The centre's +z axis points into the head.
        """
        places = grid_on_scalp(closest, centre, settings.spacing_mm / 1e3, settings.rings)
        return cls(settings, tuple(as_message(place) for place in places))

    def next(self) -> PoseMessage:
        """Return ``image_from_coil`` of the next pulse, which is always within the region.

        Raises:
            RefusalError: ``search_finished``.
        """
        if self.finished:
            text = f"The search ended after {len(self.pulses)} pulses. Start a new search to go on."
            raise RefusalError("search_finished", text, pulses=len(self.pulses))
        # Only complete groups count, so that all pulses of one place have the same pose.
        completed = self.pulses[: len(self.pulses) - len(self.pulses) % self.settings.pulses_per_place]
        if self.settings.method == "grid":
            return as_message(_mapping.next_pose(self._patch, completed))
        return as_message(_adaptive.next_pose(self._patch, completed))

    def after(self, image_from_coil: PoseMessage, amplitude: float) -> Self:
        """Return the search with one more pulse.

        Args:
            image_from_coil: Measured pose of the coil, which may differ from the requested one.
            amplitude: Peak-to-peak amplitude, V.

        Raises:
            RefusalError: ``bad_amplitude``.
            GeometryError: The pose is invalid.
        """
        if not 0.0 <= amplitude <= MAX_AMPLITUDE:  # false for nan, too
            text = f"A peak-to-peak amplitude is 0 to {MAX_AMPLITUDE:g} V, not {amplitude:g} V; leave the pulse out."
            raise RefusalError("bad_amplitude", text, amplitude=amplitude, limit=MAX_AMPLITUDE)
        as_transform(image_from_coil)
        pulse = MapPulse(image_from_coil, amplitude)
        return msgspec.structs.replace(self, pulses=(*self.pulses, pulse))

    @property
    def finished(self) -> bool:
        """True if no further pulse is needed."""
        count, settings = len(self.pulses), self.settings
        if settings.method == "grid":
            return count >= _mapping.pulse_count(self._patch)
        if count >= settings.max_pulses:
            return True
        return count >= settings.min_pulses and self.responded and self._certain()

    @property
    def responded(self) -> bool:
        """True if any pulse evoked a response."""
        return any(pulse.amplitude >= self.settings.response_uv * 1e-6 for pulse in self.pulses)

    @property
    def estimate(self) -> Hotspot:
        """Estimated hot-spot after the pulses so far.

        Raises:
            RefusalError: ``no_response``: without any response there is no hot-spot.
        """
        if not self.responded:
            text = (
                f"None of {len(self.pulses)} pulses evoked {self.settings.response_uv:g} uV, so that there is no "
                "hot-spot yet; go on, or restart with a higher intensity or another centre."
            )
            raise RefusalError("no_response", text, pulses=len(self.pulses))
        if self.settings.method == "grid":
            return _mapping.estimate(self._patch, self.pulses)
        return _adaptive.estimate(self._patch, self.pulses)

    def expected_amplitudes(self, image_from_coil: Sequence[Transform]) -> Floats:
        """Return the expected amplitudes at poses, V, (K,), after at least one pulse, with either method."""
        return _adaptive.expected_amplitudes(self._patch, self.pulses, image_from_coil)

    def pose_at(self, position: Floats, angle: float = 0.0) -> Transform:
        """Return the pose on the scalp at a position in the region.

        Args:
            position: Position in the image, m, (3,).
            angle: Heading against the places around it, rad.
        """
        return self._patch.pose_at(position, angle)

    def _certain(self) -> bool:
        return self.estimate.uncertainty * 1e3 <= self.settings.uncertainty_mm

    @property
    def _patch(self) -> ScalpPatch:
        return scalp_patch(self.settings, self.places)
