"""The map of a grid: every place, then every heading at its middle."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.tms._mapping import estimate, pulse_count
from pcmrs.tms.scalp import as_transform, heading, scalp_patch
from pcmrs.tms.settings import MapPulse
from tests.unit.tms.searches import MOST_PULSES, RNG, begun, subject_at


def test_grid_mapping_visits_all_places_then_turns_the_handle() -> None:
    """It turns the handle at the middle."""
    subject, search = subject_at(0.006, -0.006, 0.3), begun("grid", pulses_per_place=2)
    asked = []
    while not search.finished:
        asked.append(search.next())
        search = search.after(asked[-1], subject.response(as_transform(asked[-1]), 60.0, RNG))
        assert len(asked) <= MOST_PULSES
    assert asked[0::2] == asked[1::2]
    for pose, place in zip(asked[0:74:2], search.places, strict=True):
        assert np.allclose(as_transform(pose).matrix, as_transform(place).matrix, atol=1e-12)
    turning = [as_transform(pose) for pose in asked[74::2]]
    assert np.ptp([pose.translation for pose in turning], axis=0).max() < 1e-9
    middle = search.pose_at(turning[0].translation)
    assert np.degrees([heading(middle, pose) for pose in turning]) == pytest.approx(np.arange(-45.0, 46.0, 15.0))


def test_the_middle_of_a_map_is_the_centre_of_gravity() -> None:
    search = begun("grid", rings=1)
    amplitudes = [100e-6, 300e-6, 49e-6, 0.0, 60e-6, 50e-6, 1e-3]
    for amplitude in amplitudes:
        search = search.after(search.next(), amplitude)
    weights = np.array([100, 300, 0, 0, 60, 50, 1000]) / 1510.0
    middle = weights @ np.array([place.position for place in search.places])
    found = as_transform(search.estimate.image_from_coil)
    away_from_it = found.inverse() @ middle
    assert np.linalg.norm(away_from_it[:2]) < 1e-4  # it is lifted onto the scalp
    assert -1e-3 < away_from_it[2] <= 0.0


def test_map_without_responses_is_centred_and_uncertain() -> None:
    search = begun("grid", rings=1, spacing_mm=8.0)
    patch = scalp_patch(search.settings, search.places)
    pulses = [MapPulse(place, 20e-6) for place in search.places]
    found = estimate(patch, pulses)
    assert found.image_from_coil.position == pytest.approx(search.places[0].position, abs=1e-4)
    assert found.uncertainty == pytest.approx(0.008, abs=5e-4)
    assert found.heading_uncertainty is None


@pytest.mark.parametrize("per_place", [1, 3])
def test_a_map_has_as_many_pulses_as_places_and_headings(per_place: int) -> None:
    search = begun("grid", rings=2, heading_reach_deg=30.0, heading_step_deg=15.0, pulses_per_place=per_place)
    assert pulse_count(scalp_patch(search.settings, search.places)) == per_place * (19 + 5)
