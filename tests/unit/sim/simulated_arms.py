"""The arm of these tests."""

import numpy as np

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.head import surface_point
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.settings import SimSettings

FACTS = ARMS["iiwa14"]
HOME = np.array(FACTS.home)
PERIOD = 0.005


def make_arm(settings: SimSettings | None = None, force: ForceSettings | None = None) -> Arm:
    settings = settings or SimSettings()
    return Arm(FACTS, settings, force or ForceSettings(), PHANTOMS[settings.phantom])


def smooth(start: Floats, goal: Floats, duration: float = 2.0) -> JointTrajectory:
    """Minimum-jerk motion, at rest at both ends."""
    time = np.arange(0.0, duration + PERIOD / 2, PERIOD) / duration
    way = 10 * time**3 - 15 * time**4 + 6 * time**5
    return JointTrajectory(period=PERIOD, positions=(start + way[:, None] * (goal - start)).tolist())


def body_before_tool(gap: float, settings: SimSettings | None = None) -> Transform:
    """``world_from_image`` with the crown of the head `gap` (m) before the face of the arm's tool, upright on it."""
    settings = settings or SimSettings()
    tool = make_arm(settings).base_from_flange() @ settings.geometry.flange_from_coil.transform
    crown = surface_point((0.0, 0.0, 1.0))
    return tool @ Transform(np.eye(3), np.array([0.0, 0.0, -gap])) @ Transform(np.eye(3), -crown)
