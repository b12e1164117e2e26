"""Forward kinematics of an arm, computed by Pinocchio."""

from __future__ import annotations

from math import degrees

import numpy as np
import numpy.typing as npt
import pinocchio

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.joints import joint_array
from pcmrs.kinematics.urdf import urdf
from pcmrs.spatial import Floats, Transform


class ArmModel:
    """An arm of seven joints that computes where its flange is. Not to be shared between threads.

    Attributes:
        facts: What the model was made from.
        lower: Lowest joint positions, rad, (7,).
        upper: Highest joint positions, rad, (7,).
        velocity: Greatest joint speeds, rad/s, (7,).
        heights: Of the joints and the flange above the base in the upright zero posture, m, (8,).
    """

    def __init__(self, facts: ArmFacts) -> None:
        self.facts = facts
        self.lower = np.array([joint.lower for joint in facts.joints])
        self.upper = np.array([joint.upper for joint in facts.joints])
        self.velocity = np.array([joint.velocity for joint in facts.joints])
        self._model = pinocchio.buildModelFromXML(urdf(facts))
        self._data = self._model.createData()
        self._flange = self._model.getFrameId("flange")
        flange = self.forward(np.zeros(len(facts.joints)))
        self.heights = np.array([joint.translation[2] for joint in self._data.oMi[1:]] + [flange.translation[2]])

    def forward(self, q: npt.ArrayLike) -> Transform:
        """``base_from_flange`` at joint positions `q`, rad, (7,).

        Raises:
            GeometryError: `q` does not hold seven finite numbers.
        """
        pinocchio.forwardKinematics(self._model, self._data, joint_array(q))
        pose = pinocchio.updateFramePlacement(self._model, self._data, self._flange)
        return Transform(pose.rotation, pose.translation)

    def jacobian(self, q: npt.ArrayLike) -> Floats:
        """Velocity of the flange per joint velocity, (6, 7).

        Rows: linear velocity of the flange's origin, then angular velocity, both along the axes of the base.

        Raises:
            GeometryError: `q` does not hold seven finite numbers.
        """
        frame = pinocchio.LOCAL_WORLD_ALIGNED
        jacobian = pinocchio.computeFrameJacobian(self._model, self._data, joint_array(q), self._flange, frame)
        return np.asarray(jacobian)

    def check_limits(self, q: npt.ArrayLike) -> None:
        """Accepts joint positions `q`, rad, (7,), that lie within the limits.

        Raises:
            GeometryError: `q` does not hold seven finite numbers.
            UnreachableError: A joint lies outside its limits; it is named.
        """
        values = joint_array(q)
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
