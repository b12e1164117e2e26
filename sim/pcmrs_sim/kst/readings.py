"""Measurements of the cabinet, in its units: mm, rad, N, N m."""

from __future__ import annotations

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.kinematic_arm import KinematicArm

_MM = 1e3


class Readings:
    """Measurements of an arm. The cabinet computes with the nominal model, and not with the arm as it was built.

    Args:
        arm: The simulated arm.
        model: Its nominal model.

    Attributes:
        flange_from_tool: The tool frame that the client has set.
    """

    def __init__(self, arm: Arm | KinematicArm, model: ArmModel) -> None:
        self._arm = arm
        self._model = model
        self.flange_from_tool = Transform.identity()

    def joints(self) -> list[float]:
        """Return the measured joint positions, rad, (7,)."""
        return _list(self._arm.positions)

    def torques(self) -> list[float]:
        """Return the measured joint torques, N m, (7,)."""
        return _list(self._arm.torques)

    def external_torques(self) -> list[float]:
        """Return the joint torques of the environment on the arm, N m, (7,): ``J^T (R f)`` of the flange force f."""
        posture = self._arm.positions
        force = self._model.forward(posture).rotation @ np.array(self._arm.sensor.flange_force)
        return _list(self._model.jacobian(posture)[:3].T @ force)

    def pose(self) -> list[float]:
        """Return the pose of the tool frame in the base, (6,); see `to_xyzabc`."""
        return to_xyzabc(self._model.forward(self._arm.positions) @ self.flange_from_tool)

    def force(self) -> list[float]:
        """Return the external force along the axes of the tool frame, N, (3,)."""
        return _list(self._force())

    def moment(self) -> list[float]:
        """Return the external moment about the tool frame's origin, along its axes, N m, (3,)."""
        origin_in_tool = self.flange_from_tool.inverse().translation
        return _list(np.cross(origin_in_tool, self._force()))

    def _force(self) -> Floats:
        force: Floats = self.flange_from_tool.rotation.T @ np.array(self._arm.sensor.flange_force)
        return force


def to_xyzabc(pose: Transform) -> list[float]:
    """Return x, y, z in mm, then the angles A about z, B about y, C about x of ``Rz(A) Ry(B) Rx(C)`` in rad, (6,)."""
    return [*_list(_MM * pose.translation), *_list(pose.zyx)]


def from_xyzabc(values: list[float]) -> Transform:
    """Return the pose of six numbers of `to_xyzabc`."""
    return Transform.from_zyx(np.array(values[:3]) / _MM, values[3:6])


def _list(values: Floats) -> list[float]:
    numbers: list[float] = values.tolist()
    return numbers
