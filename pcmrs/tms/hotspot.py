"""The search for the motor hot-spot, pulse by pulse, whatever the method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import msgspec

from pcmrs.errors import RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform
from pcmrs.tms import adaptive, mapping
from pcmrs.tms.grid import grid_on_scalp
from pcmrs.tms.scalp import Closest, ScalpPatch, as_message, as_transform, chart_of
from pcmrs.tms.settings import Hotspot, HotspotSettings, MapPulse

MOST_AMPLITUDE = 0.1
"""V: no muscle evokes a tenth of it."""


class HotspotSearch(msgspec.Struct, frozen=True):
    """Where pulses may go and what they evoked; nothing else counts, so that it can be journalled and replayed.

    ``search = HotspotSearch.begin(settings, closest, centre)``, then ``search = search.after(measured, amplitude)``
    with the pulse at ``search.next()`` until `finished`. All pulses are given at one intensity.

    Attributes:
        places: ``image_from_coil`` of the places, in the order of the map; the first is the centre.
        pulses: That count; one whose response cannot be judged is given again and is not among them.
    """

    settings: HotspotSettings
    places: tuple[PoseMessage, ...]
    pulses: tuple[MapPulse, ...] = ()

    @classmethod
    def begin(cls, settings: HotspotSettings, closest: Closest, centre: Transform) -> Self:
        """A search without pulses.

        Args:
            settings: Where and how to search.
            closest: The scalp; it is not needed any more afterwards.
            centre: ``image_from_coil`` where the hot-spot is expected; it is brought onto the scalp.

        Raises:
            GeometryError: The centre's +z points into the head.
        """
        places = grid_on_scalp(closest, centre, settings.spacing_mm / 1e3, settings.rings)
        return cls(settings, tuple(as_message(place) for place in places))

    def next(self) -> PoseMessage:
        """``image_from_coil`` of the next pulse: always within the region.

        Raises:
            RefusalError: ``search_finished``.
        """
        if self.finished:
            text = f"The search has ended after {len(self.pulses)} pulses. Begin a new one to go on."
            raise RefusalError("search_finished", text, pulses=len(self.pulses))
        asked = self.pulses[: len(self.pulses) - len(self.pulses) % self.settings.pulses_per_place]
        if self.settings.method == "grid":
            return as_message(mapping.proposal(self._chart, asked))
        return as_message(adaptive.proposal(self._chart, asked))

    def after(self, image_from_coil: PoseMessage, amplitude: float) -> Self:
        """The search with one pulse more.

        Args:
            image_from_coil: The coil as it was measured, which need not be where it should have been.
            amplitude: Peak-to-peak, V.

        Raises:
            RefusalError: ``bad_amplitude``.
            GeometryError: The pose is none.
        """
        if not 0.0 <= amplitude <= MOST_AMPLITUDE:  # nan is not within either
            text = f"A peak-to-peak amplitude is 0 to {MOST_AMPLITUDE:g} V, not {amplitude:g} V; leave the pulse out."
            raise RefusalError("bad_amplitude", text, amplitude=amplitude, limit=MOST_AMPLITUDE)
        as_transform(image_from_coil)
        pulse = MapPulse(image_from_coil, amplitude)
        return msgspec.structs.replace(self, pulses=(*self.pulses, pulse))

    @property
    def finished(self) -> bool:
        """Whether no further pulse is asked for."""
        count, settings = len(self.pulses), self.settings
        if settings.method == "grid":
            return count >= mapping.total(self._chart)
        if count >= settings.max_pulses:
            return True
        return count >= settings.min_pulses and self.responded and self._certain()

    @property
    def responded(self) -> bool:
        """Whether any pulse has evoked a response."""
        return any(pulse.amplitude >= self.settings.response_uv * 1e-6 for pulse in self.pulses)

    @property
    def estimate(self) -> Hotspot:
        """Where the hot-spot is, as far as the pulses tell.

        Raises:
            RefusalError: ``no_response``: without one there is no hot-spot.
        """
        if not self.responded:
            text = (
                f"None of {len(self.pulses)} pulses evoked {self.settings.response_uv:g} uV, so that there is no "
                "hot-spot yet; go on, or begin again with a higher intensity or another centre."
            )
            raise RefusalError("no_response", text, pulses=len(self.pulses))
        if self.settings.method == "grid":
            return mapping.estimate(self._chart, self.pulses)
        return adaptive.estimate(self._chart, self.pulses)

    def expected(self, image_from_coil: Sequence[Transform]) -> Floats:
        """Amplitudes that are expected at poses, V, (K,), after at least one pulse: the map, by either method."""
        return adaptive.expected(self._chart, self.pulses, image_from_coil)

    def between(self, position: Floats, angle: float = 0.0) -> Transform:
        """The pose on the scalp at a position in the region, turned by `angle` (rad) from the places around it."""
        return self._chart.pose(position, angle)

    def _certain(self) -> bool:
        return self.estimate.uncertainty * 1e3 <= self.settings.uncertainty_mm

    @property
    def _chart(self) -> ScalpPatch:
        return chart_of(self.settings, self.places)
