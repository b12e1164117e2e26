"""What the cabinet measures, in its own units: mm, rad, N, N m."""

from __future__ import annotations

import numpy as np

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.kinematic_arm import KinematicArm

_MM = 1e3


class Readings:
    """Reads the arm; the cabinet knows the arm as its data sheet has it, not as it was built.

    Args:
        arm: The simulated arm.
        model: The same by its data sheet.

    Attributes:
        flange_from_tool: The tool frame that the client has set.
    """

    def __init__(self, arm: Arm | KinematicArm, model: ArmModel) -> None:
        self._arm = arm
        self._model = model
        self.flange_from_tool = Transform.identity()

    def joints(self) -> list[float]:
        """Measured joint positions, rad, 7."""
        return _list(self._arm.positions)

    def torques(self) -> list[float]:
        """Measured joint torques, N m, 7."""
        return _list(self._arm.torques)

    def external_torques(self) -> list[float]:
        """Joint torques by which the environment acts on the arm, N m, 7: ``J^T (R f)`` of the force on the flange."""
        posture = self._arm.positions
        force = self._model.forward(posture).rotation @ np.array(self._arm.sensor.flange_force)
        return _list(self._model.jacobian(posture)[:3].T @ force)

    def pose(self) -> list[float]:
        """Pose of the tool frame in the base: x, y, z in mm, A about z, B about y, C about x in rad."""
        return to_xyzabc(self._model.forward(self._arm.positions) @ self.flange_from_tool)

    def force(self) -> list[float]:
        """External force along the axes of the tool frame, N, 3."""
        return _list(self._force())

    def moment(self) -> list[float]:
        """External moment about the tool frame's origin along its axes, N m, 3."""
        origin_in_tool = self.flange_from_tool.inverse().translation
        return _list(np.cross(origin_in_tool, self._force()))

    def _force(self) -> Floats:
        force: Floats = self.flange_from_tool.rotation.T @ np.array(self._arm.sensor.flange_force)
        return force


def to_xyzabc(pose: Transform) -> list[float]:
    """x, y, z in mm, then the angles of ``Rz(A) Ry(B) Rx(C)`` in rad."""
    return [*_list(_MM * pose.translation), *_list(pose.zyx)]


def from_xyzabc(values: list[float]) -> Transform:
    """The pose that `to_xyzabc` describes."""
    return Transform.from_zyx(np.array(values[:3]) / _MM, values[3:6])


def _list(values: Floats) -> list[float]:
    numbers: list[float] = values.tolist()
    return numbers
