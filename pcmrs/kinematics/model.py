"""Forward kinematics of an arm, computed by Pinocchio."""

from __future__ import annotations

from math import degrees

import numpy as np
import numpy.typing as npt
import pinocchio

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._geometry import recognize
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.limits import joint_array
from pcmrs.kinematics.urdf import urdf
from pcmrs.spatial import Floats, Transform, trusted_transform

__all__ = ["ArmModel"]


class ArmModel:
    """A serial arm that computes the pose of its flange. Do not share it between threads.

    Args:
        facts: Facts of the arm.

    Attributes:
        facts: Facts that the model was made from.
        joints: Number n of joints.
        lower: Lowest joint positions, rad, (n,).
        upper: Highest joint positions, rad, (n,).
        velocity: Greatest joint speeds, rad/s, (n,).
        geometry: Geometry with which inverse kinematics has a closed form, or None if no known one fits.
    """

    def __init__(self, facts: ArmFacts) -> None:
        self.facts = facts
        self.joints = len(facts.joints)
        self.lower = np.array([joint.lower for joint in facts.joints])
        self.upper = np.array([joint.upper for joint in facts.joints])
        self.velocity = np.array([joint.velocity for joint in facts.joints])
        self._model = pinocchio.buildModelFromXML(urdf(facts))
        self._data = self._model.createData()
        self._flange = self._model.getFrameId("flange")
        flange = self.forward(np.zeros(self.joints))
        poses = list(self._data.oMi[1:])
        axes = np.array([pose.rotation[:, 2] for pose in poses])
        self.geometry = recognize(axes, np.array([pose.translation for pose in poses]), flange)

    def forward(self, q: npt.ArrayLike) -> Transform:
        """Return ``base_from_flange`` at joint positions `q`, rad, (n,).

        Raises:
            GeometryError: `q` does not hold one finite number per joint.
        """
        pinocchio.forwardKinematics(self._model, self._data, joint_array(q, self.joints))
        pose = pinocchio.updateFramePlacement(self._model, self._data, self._flange)
        return trusted_transform(np.array(pose.rotation), np.array(pose.translation))

    def jacobian(self, q: npt.ArrayLike) -> Floats:
        """Return the Jacobian of the flange's velocity with respect to the joint velocities, (6, n).

        Rows: linear velocity of the flange's origin, then angular velocity, both along the axes of the base.

        Raises:
            GeometryError: `q` does not hold one finite number per joint.
        """
        frame = pinocchio.LOCAL_WORLD_ALIGNED
        jacobian = pinocchio.computeFrameJacobian(
            self._model, self._data, joint_array(q, self.joints), self._flange, frame
        )
        return np.asarray(jacobian)

    def pose_error_and_jacobian(self, base_from_flange: Transform, q: Floats) -> tuple[Floats, Floats]:
        """Return the remaining error to a flange pose, and the Jacobian at the present posture.

        Both in one call, because each step of inverse kinematics needs both and the forward kinematics are computed
        once.

        Args:
            base_from_flange: Desired pose of the flange in the robot's base.
            q: Joint positions as returned by `joint_array`, rad, (n,). They are not checked.

        Returns:
            Error as translation (m) and rotation vector (rad), along the axes of the base, (6,); and the `jacobian` at
            `q`, (6, n).
        """
        frame = pinocchio.LOCAL_WORLD_ALIGNED
        jacobian = pinocchio.computeFrameJacobian(self._model, self._data, q, self._flange, frame)
        pose = pinocchio.updateFramePlacement(self._model, self._data, self._flange)
        turn = pinocchio.log3(base_from_flange.rotation @ pose.rotation.T)
        return np.concatenate((base_from_flange.translation - pose.translation, turn)), jacobian

    def joint_origins(self, q: npt.ArrayLike) -> Floats:
        """Return the origins of the joint frames in the base at joint positions `q`, m, (n, 3).

        Raises:
            GeometryError: `q` does not hold one finite number per joint.
        """
        pinocchio.forwardKinematics(self._model, self._data, joint_array(q, self.joints))
        return np.array([joint.translation for joint in self._data.oMi[1:]])

    def check_limits(self, q: npt.ArrayLike) -> None:
        """Raise an error unless joint positions `q`, rad, (n,), lie within the limits.

        Raises:
            GeometryError: `q` does not hold one finite number per joint.
            UnreachableError: A joint lies outside its limits; the text names it.
        """
        values = joint_array(q, self.joints)
        for joint, value in zip(self.facts.joints, values.tolist(), strict=True):
            if not joint.lower <= value <= joint.upper:
                raise UnreachableError(
                    f"{joint.name} at {degrees(value):.2f} deg is outside its limits {degrees(joint.lower):.0f} to "
                    f"{degrees(joint.upper):.0f} deg; choose another posture.",
                    joint=joint.name,
                    position=value,
                    lower=joint.lower,
                    upper=joint.upper,
                )
