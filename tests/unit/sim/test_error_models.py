import numpy as np
import numpy.typing as npt
import pytest

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform, distance
from pcmrs_sim.error_models import BASELINE, BiasField, TouchErrors, TrackerErrors, displaced
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.settings import DigitizationSettings, TrackerSettings

PLACES = np.random.default_rng(0).uniform(-2.0, 2.0, (4000, 3))
TRUE_POSE = Transform.from_rotvec((0.1, -0.2, -1.2), (0.5, -1.0, 2.0))


@pytest.mark.parametrize("seed", range(5))
def test_bias_has_its_magnitude_over_places(seed: int) -> None:
    field = BiasField(1e-4, np.random.default_rng(seed))
    biases = np.array([field.at(place) for place in PLACES])
    assert np.sqrt(np.mean(np.sum(biases**2, axis=1))) == pytest.approx(1e-4, rel=0.1)


def test_bias_is_fixed_per_seed_and_smooth() -> None:
    field, same, other = (BiasField(1e-4, np.random.default_rng(seed)) for seed in (1, 1, 2))
    place = PLACES[0]
    assert np.array_equal(field.at(place), same.at(place))
    assert not np.allclose(field.at(place), other.at(place))
    assert np.linalg.norm(field.at(place) - field.at(place + 0.001)) < 1e-5


def test_the_arm_is_built_beside_its_model_by_the_stated_error() -> None:
    facts, rng = ARMS["iiwa14"], np.random.default_rng(0)
    model, errors = ArmModel(facts), []
    for seed in range(40):
        true = ArmModel(displaced(facts, 1e-3, seed))
        postures = rng.uniform(model.lower, model.upper, (20, 7))
        errors += [distance(true.forward(posture), model.forward(posture)) for posture in postures]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1e-3, rel=0.1)


def test_the_arm_is_built_the_same_for_a_seed() -> None:
    facts = ARMS["iiwa14"]
    assert displaced(facts, 1e-3, 3) == displaced(facts, 1e-3, 3) != displaced(facts, 1e-3, 4)
    assert displaced(facts, 0.0, 3) == facts


SPHERES = MARKER_BODIES["body_ref"].positions
ALL = np.ones(len(SPHERES), dtype=bool)


def jitter(pose: Transform, seen: npt.NDArray[np.bool_] = ALL, count: int = 3000) -> tuple[Floats, Floats, float]:
    """Deviations of translation, m, and rotation, rad, in the tracker frame, (3,) each; rms fit error, m."""
    errors = TrackerErrors(TrackerSettings(bias_mm=0.0, bias_deg=0.0), np.random.default_rng(3))
    measured, fits = zip(*(errors.measure(pose, SPHERES, seen) for _ in range(count)), strict=True)
    turns = [Transform(each.rotation @ pose.rotation.T, np.zeros(3)).rotvec for each in measured]
    translations = np.array([each.translation for each in measured])
    assert np.abs(translations.mean(axis=0) - pose.translation).max() < 2e-6
    return translations.std(axis=0), np.std(turns, axis=0), float(np.sqrt(np.mean(np.square(fits))))


def test_the_noise_of_spheres_is_that_of_two_cameras() -> None:
    """At 1.2 m straight ahead: s r across the line of sight and 2 r^2 s / b along it, over four spheres."""
    translation, rotation, _ = jitter(Transform(np.eye(3), np.array((0.0, 0.0, -1.2))))
    lateral, depth = 5e-6 * 1.2, 5e-6 * 2 * 1.2**2 / BASELINE
    assert translation == pytest.approx(np.array((lateral, lateral, depth)) / 2.0, rel=0.05)
    spread = np.sqrt(np.sum(SPHERES**2, axis=0))
    in_plane = lateral / np.hypot(spread[0], spread[1])
    assert rotation[2] == pytest.approx(in_plane, rel=0.05)
    assert np.degrees(rotation[:2]).max() < 0.04
    assert rotation[:2].min() > 3.0 * in_plane


def test_the_pose_is_worse_far_away_and_with_fewer_spheres() -> None:
    near, far = (Transform(np.eye(3), np.array((0.0, 0.0, -depth))) for depth in (1.0, 2.0))
    assert jitter(far)[0][2] == pytest.approx(4.0 * jitter(near)[0][2], rel=0.1)
    assert jitter(far)[0][0] == pytest.approx(2.0 * jitter(near)[0][0], rel=0.1)
    three = jitter(near, np.array((True, True, False, True)))
    assert np.linalg.norm(three[1]) > 1.1 * np.linalg.norm(jitter(near)[1])


def test_the_fit_error_is_the_scatter_that_the_pose_leaves() -> None:
    """Of the 12 coordinates of four spheres, six go into the pose."""
    depth = 5e-6 * 2 * 1.0 / BASELINE
    fit = jitter(Transform(np.eye(3), np.array((0.0, 0.0, -1.0))))[2]
    assert 0.3 * depth < fit < depth


def test_a_perfect_tracker_tells_the_truth() -> None:
    errors = TrackerErrors(TrackerSettings(jitter_mm=0.0, bias_mm=0.0, bias_deg=0.0), np.random.default_rng(0))
    measured, fit = errors.measure(TRUE_POSE, SPHERES, ALL)
    assert np.allclose(measured.matrix, TRUE_POSE.matrix, atol=1e-12)
    assert fit < 1e-12
    assert errors.jitter_free


def test_touches_combine_to_the_stated_deviation() -> None:
    touches = [TouchErrors(DigitizationSettings(), seed).next(index) for seed in range(200) for index in range(6)]
    assert np.std(touches) * 1e3 == pytest.approx(1.86, rel=0.05)


def test_touches_of_a_landmark_share_a_bias_and_repeat_by_seed() -> None:
    errors, same = TouchErrors(DigitizationSettings(), 7), TouchErrors(DigitizationSettings(), 7)
    touches = np.array([errors.next(2) for _ in range(1000)])
    assert (touches.std(axis=0) * 1e3).mean() == pytest.approx(0.95, rel=0.1)
    same.next(1)
    assert np.array_equal(same.next(2), touches[0])
