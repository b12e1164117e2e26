"""A posture inside the workspace, and the proof that a posture reaches a pose, for tests of inverse kinematics."""

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Transform, distance, rotation_angle

READY = np.array((0.1, 0.5, 0.2, -1.2, 0.3, 0.9, 0.1))


def assert_reaches(arm: ArmModel, q: np.ndarray, target: Transform) -> None:
    arm.check_limits(q)
    assert distance(arm.forward(q), target) < 1e-9
    assert rotation_angle(arm.forward(q), target) < 1e-9
