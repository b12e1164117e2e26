"""Places at which the simulated arm comes to rest."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats
from pcmrs_sim.error_models import RestingPlaces
from pcmrs_sim.settings import ArmSettings, SimSettings
from pcmrs_sim.world import World

FACTS = ARMS["iiwa14"]


def test_repeatability_is_that_of_the_standard() -> None:
    """ISO 9283: mean distance from the mean place, plus three standard deviations of it."""
    places = RestingPlaces(0.15e-3, 1)
    drawn = np.array([places.draw() for _ in range(20_000)])
    distances = np.linalg.norm(drawn - drawn.mean(axis=0), axis=1)
    assert distances.mean() + 3.0 * distances.std(ddof=1) == pytest.approx(0.15e-3, rel=0.02)


def rests(repeatability_mm: float) -> tuple[list[Floats], list[Floats]]:
    """Places of the tool, and joints, after the same motion was made several times."""
    arm = ArmSettings(physics="kinematic", repeatability_mm=repeatability_mm)
    world = World(SimSettings(arm=arm), FACTS, ForceSettings(), 0.0)
    places, joints = [], []
    for _ in range(4):
        here = world.arm.positions
        for goal in (here + 0.05, here):
            steps = np.linspace(world.arm.positions, goal, 20).tolist()
            world.arm.follow(JointTrajectory(period=0.005, positions=steps))
            world.step(300)
        places.append(world.tracker_from_tool_tip().translation)
        joints.append(world.arm.positions)
    return places, joints


def test_the_tool_rests_elsewhere_after_each_motion() -> None:
    places, joints = rests(0.15)
    np.testing.assert_allclose(joints, joints[0][None].repeat(4, axis=0), atol=1e-9)
    gaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert gaps.min() > 1e-6
    assert gaps.max() < 0.4e-3


def test_without_it_the_tool_returns_exactly() -> None:
    places, _ = rests(0.0)
    np.testing.assert_allclose(places, places[0][None].repeat(4, axis=0), atol=1e-9)
