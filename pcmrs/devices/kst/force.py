"""Estimate of the force on the flange from the external joint torques."""

from __future__ import annotations

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats

DAMPING = 0.01
"""Damping of the inverse Jacobian: keeps the estimate finite at singularities and lowers it by about 1 % elsewhere."""


class TorqueForce:
    """Implements `pcmrs.devices.motion.force.FlangeForce` by least squares of ``tau = J^T wrench``.

    The wrench is ``(J J^T + damping^2 I)^-1 J tau``; for the statics see Siciliano et al., Robotics, 2009, section 3.8.

    Args:
        model: Model of the arm.
        axis_in_flange: Unit vector of the tool's +z in the flange's axes, along which contact pushes, (3,).

    Attributes:
        axis: As `axis_in_flange`.
        flange_force: External force along the flange's axes, N.
    """

    def __init__(self, model: ArmModel, axis_in_flange: Floats) -> None:
        self._model = model
        self.axis = axis_in_flange
        self.flange_force = (0.0, 0.0, 0.0)

    def update(self, positions: Floats, torques: Floats) -> None:
        """Update the estimate.

        Args:
            positions: Measured joints, rad, (n,).
            torques: External joint torques, N m, (n,).
        """
        jacobian = self._model.jacobian(positions)
        wrench = np.linalg.solve(jacobian @ jacobian.T + DAMPING**2 * np.eye(6), jacobian @ torques)
        x, y, z = (self._model.forward(positions).rotation.T @ wrench[:3]).tolist()
        self.flange_force = (x, y, z)

    @property
    def magnitude(self) -> float:
        """Magnitude of the force, N."""
        return float(np.linalg.norm(self.flange_force))
