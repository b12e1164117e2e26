"""Profiles of position over time with bounded jerk, computed by Ruckig.

L. Berscheid, T. Kröger, Jerk-limited Real-time Trajectory Generation with Arbitrary Target States, RSS 2021.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from ruckig import InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from pcmrs.errors import GeometryError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.spatial import Floats

PERIOD = 0.005  # s between the samples of a trajectory


def joint_request(velocity: Floats, limits: MotionLimits) -> InputParameter:
    """A motion of all joints along a straight line of joint space, with `velocity` (n,) as speed limits, rad/s."""
    request = InputParameter(len(velocity))
    request.synchronization = Synchronization.Phase
    request.max_velocity = velocity.tolist()
    request.max_acceleration = list(limits.joint_acceleration)
    request.max_jerk = list(limits.joint_jerk)
    return request


def solve(request: InputParameter) -> Trajectory:
    """The fastest profile.

    Raises:
        GeometryError: There is none.
    """
    profile = Trajectory(request.degrees_of_freedom)
    try:
        Ruckig(request.degrees_of_freedom).calculate(request, profile)
    except RuckigError as error:
        raise GeometryError(f"No motion profile exists: {error}; check positions, velocities and limits.") from error
    return profile


def sample_times(duration: float, stretch: float, period: float) -> Floats:
    """Times of a profile at which to sample it so that one sample per period plays it `stretch` times slower."""
    return np.linspace(0.0, duration, max(1, ceil(duration * stretch / period)) + 1)
