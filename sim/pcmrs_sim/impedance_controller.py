"""The joint-impedance controller of the arm, with integral action."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.spatial import Floats
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings

DAMPING_RATIO = 0.7
"""Damping ratio of each joint at the home posture."""


class ImpedanceController:
    """Controller that computes joint torques from the reference and the measured state, once per `STEP`.

    The torque is ``inverse dynamics of the reference by the nominal model + K e + D de/dt + integral of Ki e``, with
    ``e`` the reference minus the measured posture. It is the joint impedance of Albu-Schaeffer et al., A unified
    passivity-based control framework for position, torque and impedance control of flexible joint robots, IJRR 2007,
    for rigid joints and with integral action.

    Args:
        nominal: The nominal model of the arm, an ``mujoco.MjModel``.
        facts: Geometry and limits of the arm, with its default stiffness.
        settings: Gains.
        home: Posture for which the damping is computed, rad, (n,).

    Attributes:
        error: Reference minus measured posture at the last step, rad, (n,); infinite before the first.
    """

    def __init__(self, nominal: Any, facts: ArmFacts, settings: ArmSettings, home: Floats) -> None:
        self._nominal = nominal
        self._data = mujoco.MjData(nominal)
        self._stiffness = np.array(settings.stiffness or facts.stiffness)
        self._damping = 2 * DAMPING_RATIO * np.sqrt(self._stiffness * _joint_inertias(nominal, home))
        self._integral_gain = self._stiffness * settings.integral_rate * STEP
        self._integral = np.zeros_like(home)
        # The error is unknown before the first step. Infinity keeps the arm from counting as at rest.
        self.error = np.full_like(home, np.inf)

    def torque(self, reference: Floats, position: Floats, velocity: Floats) -> Floats:
        """Return the joint torques, N m, (n,).

        Args:
            reference: Position rad, velocity rad/s and acceleration rad/s^2, (3, n).
            position: Measured positions, rad, (n,).
            velocity: Measured velocities, rad/s, (n,).
        """
        data = self._data
        data.qpos[:], data.qvel[:], data.qacc[:] = reference
        mujoco.mj_inverse(self._nominal, data)
        np.subtract(reference[0], position, out=self.error)
        self._integral += self._integral_gain * self.error
        torque: Floats = (
            data.qfrc_inverse
            + self._integral
            + self._stiffness * self.error
            + self._damping * (reference[1] - velocity)
        )
        return torque


def _joint_inertias(model: Any, posture: Floats) -> Floats:
    """Return the diagonal of the joint-space inertia matrix at a posture, rad, (n,), in kg m^2, (n,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = posture
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return np.diag(inertia).copy()
