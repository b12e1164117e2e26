"""An arm, limits of its motion, and the proof that a trajectory keeps them, for tests."""

import numpy as np
from hypothesis import strategies as st

from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import MotionLimits
from pcmrs.messages import JointTrajectory

ARM = ArmModel(IIWA14_R820)

LIMITS = MotionLimits(
    joint_velocity=(0.8,) * 7,
    joint_acceleration=(2.0,) * 7,
    joint_jerk=(20.0,) * 7,
    linear_velocity=0.2,
    linear_acceleration=0.5,
    linear_jerk=4.0,
    angular_velocity=0.5,
    angular_acceleration=2.0,
)

seeds = st.integers(0, 2**32 - 1)


def derivative(trajectory: JointTrajectory, order: int) -> np.ndarray:
    """The greatest n-th derivative of each joint, by differences; the arm rests before and after."""
    padded = np.pad(np.array(trajectory.positions), ((3, 3), (0, 0)), mode="edge")
    return np.asarray(np.abs(np.diff(padded, order, axis=0)).max(axis=0) / trajectory.period**order)


def assert_within_joint_limits(trajectory: JointTrajectory) -> None:
    for order, bound in enumerate((LIMITS.joint_velocity, LIMITS.joint_acceleration, LIMITS.joint_jerk), start=1):
        assert np.all(derivative(trajectory, order) <= np.array(bound) * (1 + 1e-6))
