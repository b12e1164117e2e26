"""The simulated subject: what each pose of the coil achieves, by the published numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Transform
from pcmrs.tms.scalp import along_scalp, heading, turned
from pcmrs_sim.tms.subject import HALF_AREA, HALF_DEPTH, REACH, TURN_REACH, Subject, draw
from tests.support.trials import examples
from tests.unit.tms.heads import TOP, Steady, phantom, sphere

SUBJECT = Subject(Steady(50.0), turned(TOP, 0.3))


def share(image_from_coil: Transform) -> float:
    return SUBJECT.effective(image_from_coil, 1.0)


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Transform:
    return SUBJECT.image_from_hotspot @ Transform(np.eye(3), np.array((x, y, z)))


def test_at_the_hotspot_all_of_the_intensity_counts() -> None:
    assert SUBJECT.effective(SUBJECT.image_from_hotspot, 63.0) == pytest.approx(63.0)


def test_half_of_the_field_is_left_at_the_published_distances() -> None:
    radius = math.sqrt(HALF_AREA / math.pi)
    for angle in np.linspace(0.0, 6.0, 7):
        assert share(moved(radius * math.cos(angle), radius * math.sin(angle))) == pytest.approx(0.5)
    assert share(moved(z=HALF_DEPTH)) == pytest.approx(0.5)


def test_a_millimetre_of_distance_costs_what_stokes_measured() -> None:
    """3 % of the maximum output per mm at thresholds around 60 %: 5 %."""
    assert 1.0 / share(moved(z=0.001)) - 1.0 == pytest.approx(3.0 / 60.0, abs=0.003)


def test_thresholds_over_the_orientation_are_those_of_richter() -> None:
    """51.3 % at best, 70.6 % across, 60.7 % the other way round."""
    for angle_deg, threshold in ((0.0, 51.3), (90.0, 70.6), (-90.0, 70.6), (180.0, 60.7)):
        turned_coil = turned(SUBJECT.image_from_hotspot, math.radians(angle_deg))
        assert 51.3 / share(turned_coil) == pytest.approx(threshold)
    angles = np.linspace(-math.pi, math.pi, 361)
    shares = [share(turned(SUBJECT.image_from_hotspot, angle)) for angle in angles]
    assert abs(angles[int(np.argmax(shares))]) < 0.02


def test_a_coil_is_the_worse_the_more_it_is_tilted() -> None:
    tilts = [Transform.from_rotvec((0.0, 0.0, 0.0), (math.radians(tilt), 0.0, 0.0)) for tilt in range(0, 91, 10)]
    shares = [share(SUBJECT.image_from_hotspot @ tilt) for tilt in tilts]
    assert shares == sorted(shares, reverse=True)
    assert 0.9 < shares[2] < 0.99
    assert shares[9] == pytest.approx(0.0, abs=1e-9)


@examples(50)
@given(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), st.floats(-3.1, 3.1))
def test_no_pose_on_the_scalp_is_better_than_the_hotspot(x: float, y: float, angle: float) -> None:
    (pose,) = along_scalp(sphere, SUBJECT.image_from_hotspot, [[x, y]])
    assert share(turned(pose, angle)) <= 1.0 + 1e-9


def test_drawn_subjects_lie_around_the_hand_area_and_differ() -> None:
    """Their hotspots lie on the scalp."""
    surface, centre = phantom()
    subjects = [draw(surface.closest, centre, np.random.default_rng(seed)) for seed in range(40)]
    hotspots = [subject.image_from_hotspot for subject in subjects]
    positions = np.array([hotspot.translation for hotspot in hotspots])
    nearest, normals = surface.closest(positions)
    assert np.abs(nearest - positions).max() < 1e-9
    assert np.abs(np.array([hotspot.rotation[:, 2] for hotspot in hotspots]) - normals).max() < 1e-9
    distances = np.linalg.norm(positions - centre.translation, axis=1)
    assert distances.max() <= REACH
    assert 0.006 < np.median(distances) < 0.013
    turns = np.array([heading(centre, hotspot) for hotspot in hotspots])
    assert np.abs(turns).max() <= TURN_REACH + 0.02  # carried along a curved scalp
    assert math.radians(12.0) < turns.std() < math.radians(25.0)
    assert len({subject.recruitment.threshold for subject in subjects}) == 40


def test_one_seed_gives_one_subject_and_one_response() -> None:
    surface, centre = phantom()
    first, again = (draw(surface.closest, centre, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(first.image_from_hotspot.matrix, again.image_from_hotspot.matrix)
    answers = [subject.response(centre, 60.0, np.random.default_rng(6)) for subject in (first, again)]
    assert answers[0] == answers[1] > 0.0


def test_responses_are_larger_near_the_hotspot() -> None:
    surface, centre = phantom()
    subject = draw(surface.closest, centre, np.random.default_rng(1))
    (far,) = along_scalp(surface.closest, subject.image_from_hotspot, [[0.02, 0.0]])
    rng, percent = np.random.default_rng(2), 1.2 * subject.recruitment.threshold
    near_v = np.median([subject.response(subject.image_from_hotspot, percent, rng) for _ in range(50)])
    far_v = np.median([subject.response(far, percent, rng) for _ in range(50)])
    assert near_v > 50e-6 > far_v
