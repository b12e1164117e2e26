"""The arm of these tests."""

from copy import deepcopy
from functools import cache

import numpy as np

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.error_models import displaced
from pcmrs_sim.head import surface_point
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.settings import SimSettings

FACTS = ARMS["iiwa14"]
HOME = np.array(FACTS.home)
PERIOD = 0.005


def new_arm(settings: SimSettings, force: ForceSettings) -> Arm:
    return Arm(FACTS, settings, force, PHANTOMS[settings.phantom])


# Its integral action settles for two seconds of the simulation at the start.
_settled_arm = cache(new_arm)


def make_arm(settings: SimSettings | None = None, force: ForceSettings | None = None) -> Arm:
    """An arm as if it were new."""
    return deepcopy(_settled_arm(settings or SimSettings(), force or ForceSettings()))


def smooth(start: Floats, goal: Floats, duration: float = 2.0) -> JointTrajectory:
    """Minimum-jerk motion, at rest at both ends."""
    time = np.arange(0.0, duration + PERIOD / 2, PERIOD) / duration
    way = 10 * time**3 - 15 * time**4 + 6 * time**5
    return JointTrajectory(period=PERIOD, positions=(start + way[:, None] * (goal - start)).tolist())


def body_before_tool(gap: float, settings: SimSettings | None = None) -> Transform:
    """``world_from_image`` with the crown of the head `gap` (m) before the face of the arm's tool, upright on it."""
    settings = settings or SimSettings()
    true_facts = displaced(FACTS, settings.arm.geometry_error_mm * 1e-3, settings.seed)
    tool = ArmModel(true_facts).forward(HOME) @ settings.geometry.flange_from_tool_tip.transform
    crown = surface_point((0.0, 0.0, 1.0))
    return tool @ Transform(np.eye(3), np.array([0.0, 0.0, -gap])) @ Transform(np.eye(3), -crown)
