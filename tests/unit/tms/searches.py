"""Searches for a hot-spot on the head phantom."""

from __future__ import annotations

import msgspec
import numpy as np

from pcmrs.spatial import Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import along_scalp, as_message, as_transform, turned
from pcmrs.tms.settings import HotspotMethod, HotspotSettings
from pcmrs_sim.tms.subject import Subject
from tests.unit.tms.heads import Steady, phantom

RNG = np.random.default_rng(0)
MOST_PULSES = 200
"""No search of these tests asks for more."""


def begun(method: HotspotMethod = "adaptive", **given: float) -> HotspotSearch:
    surface, centre = phantom()
    chosen = msgspec.convert({"method": method, **given}, HotspotSettings)
    return HotspotSearch.begin(chosen, surface.closest, centre)


def subject_at(x: float, y: float, angle: float) -> Subject:
    surface, centre = phantom()
    (hotspot,) = along_scalp(surface.closest, centre, [[x, y]])
    return Subject(Steady(50.0), turned(hotspot, angle))


def run(search: HotspotSearch, subject: Subject, shift: Transform | None = None) -> HotspotSearch:
    """The whole search; `shift` is how the coil is off in its own frame."""
    while not search.finished:
        pose = as_transform(search.next())
        measured = pose if shift is None else pose @ shift
        search = search.after(as_message(measured), subject.response(measured, 60.0, RNG))
        assert len(search.pulses) <= MOST_PULSES
    return search


def away(search: HotspotSearch, subject: Subject) -> float:
    found = as_transform(search.estimate.image_from_coil)
    return float(np.linalg.norm(found.translation - subject.image_from_hotspot.translation))
