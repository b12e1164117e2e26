"""Tolerance of a placement from the scatter of tracker frames."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.spatial import Transform
from pcmrs.workflows._tracker_noise import Tolerance, noise
from pcmrs.workflows.settings import PlacementSettings

LIMITS = PlacementSettings()


def frames(
    rng: np.random.Generator, mm: float, deg: float = 0.0, drift_mm: float = 0.0, many: int = 60
) -> list[Transform]:
    """Poses of a tool at rest with white noise per axis, and an even motion of the body over the whole measurement."""
    return [
        Transform.from_rotvec(
            rng.normal(0.0, mm * 1e-3, 3) + np.array([drift_mm * 1e-3 * frame / many, 0.0, 0.0]),
            rng.normal(0.0, np.radians(deg), 3),
        )
        for frame in range(many)
    ]


@pytest.mark.parametrize("drift_mm", [0.0, 2.0], ids=["at_rest", "moving_evenly"])
def test_noise_is_the_scatter_of_groups_whatever_the_drift(drift_mm: float) -> None:
    rng = np.random.default_rng(1)
    seen = np.array([noise(frames(rng, 0.2, 0.1, drift_mm)) for _ in range(60)])
    expected = np.sqrt(3.0 / 15.0) * np.array([0.2, 0.1])
    np.testing.assert_allclose(np.sqrt((seen**2).mean(axis=0)), expected, rtol=0.1)


def test_slow_fluctuations_are_not_averaged_away() -> None:
    """Frames that wander together over a quarter of the measurement count in full."""
    slow = np.repeat(np.array([[0.0, 0.0, 0.0], [2e-4, 0.0, 0.0], [0.0, 0.0, 0.0], [2e-4, 0.0, 0.0]]), 15, axis=0)
    wandering = [Transform.from_rotvec(place, np.zeros(3)) for place in slow]
    assert noise(wandering)[0] > 0.1


def test_a_quiet_tracker_keeps_the_configured_tolerance() -> None:
    quiet = Tolerance.by_noise(frames(np.random.default_rng(3), 0.01), LIMITS)
    assert (quiet.mm, quiet.deg) == (LIMITS.tolerance_mm, LIMITS.tolerance_deg)


def test_tolerance_is_twice_the_noise() -> None:
    seen = Tolerance.by_noise(frames(np.random.default_rng(4), 0.25, 0.1), LIMITS)
    assert seen.mm == pytest.approx(2.0 * seen.noise_mm)
    assert seen.deg == pytest.approx(2.0 * seen.noise_deg)
    assert LIMITS.tolerance_mm < seen.mm < 0.5
    assert f"noise {seen.noise_mm:.2f} mm" in seen.text


def test_however_noisy_the_tolerance_has_an_upper_bound() -> None:
    seen = Tolerance.by_noise(frames(np.random.default_rng(5), 5.0, 5.0), LIMITS)
    assert (seen.mm, seen.deg) == (0.5, 0.2)


def test_repeatability_of_the_arm_adds_to_the_noise() -> None:
    seen = Tolerance.by_noise(frames(np.random.default_rng(8), 0.25), PlacementSettings(repeatability_mm=0.15))
    assert seen.mm == pytest.approx(np.hypot(2.0 * seen.noise_mm, 0.15))


def test_noise_can_be_left_out_of_the_tolerance() -> None:
    alone = PlacementSettings(noise_factor=0.0)
    seen = Tolerance.by_noise(frames(np.random.default_rng(6), 5.0, 5.0), alone)
    assert (seen.mm, seen.deg) == (alone.tolerance_mm, alone.tolerance_deg)


def test_too_few_frames_show_no_noise() -> None:
    assert noise(frames(np.random.default_rng(7), 5.0, many=3)) == (0.0, 0.0)
