import numpy as np
import pytest

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Transform, distance
from pcmrs_sim.error_models import BiasField, TouchErrors, TrackerErrors, displaced
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


def test_jitter_has_its_deviation_per_axis() -> None:
    settings = TrackerSettings(bias_mm=0.0, bias_deg=0.0)
    errors = TrackerErrors(settings, np.random.default_rng(3))
    measured = [errors.measure(TRUE_POSE) for _ in range(4000)]
    translations = np.array([pose.translation - TRUE_POSE.translation for pose in measured])
    turns = np.array([Transform(pose.rotation @ TRUE_POSE.rotation.T, np.zeros(3)).rotvec for pose in measured])
    assert translations.std(axis=0) == pytest.approx(3e-5, rel=0.05)
    assert np.degrees(turns.std(axis=0)) == pytest.approx(0.02, rel=0.05)
    assert np.abs(translations.mean(axis=0)).max() < 2e-6


def test_a_perfect_tracker_tells_the_truth() -> None:
    errors = TrackerErrors(TrackerSettings(60.0, 0.03, 0.0, 0.0, 0.0, 0.0), np.random.default_rng(0))
    measured = errors.measure(TRUE_POSE)
    assert np.allclose(measured.matrix, TRUE_POSE.matrix, atol=1e-15)
    assert errors.fit_error() == 0.0


def test_touches_combine_to_the_stated_deviation() -> None:
    touches = [TouchErrors(DigitizationSettings(), seed).next(index) for seed in range(200) for index in range(6)]
    assert np.std(touches) * 1e3 == pytest.approx(1.86, rel=0.05)


def test_touches_of_a_landmark_share_a_bias_and_repeat_by_seed() -> None:
    errors, same = TouchErrors(DigitizationSettings(), 7), TouchErrors(DigitizationSettings(), 7)
    touches = np.array([errors.next(2) for _ in range(1000)])
    assert (touches.std(axis=0) * 1e3).mean() == pytest.approx(0.95, rel=0.1)
    same.next(1)
    assert np.array_equal(same.next(2), touches[0])
