"""Removal of the points that belong to the arm, its tool and the body: what remains is not expected in the scene."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.zones import ToolShape
from pcmrs.spatial import Floats, Transform

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Margins:
    """Distances from a known body within which a point belongs to it, m.

    Attributes:
        arm: Distance from the arm: error of calibration, and its motion between measurement and image.
        body: Distance from the body: its motion since the registration.
    """

    arm: float
    body: float


class KnownBodies:
    """Models of arm, tool and body.

    Args:
        arm: Model of the arm.
        flange_from_tool_tip: Pose of the tool's contact point on the flange.
        tool: Shape of the tool.
        margins: Distances within which a point belongs to a model.
        surface_in_base: Points of the body's surface in the robot's base, m, (n, 3); None for no body.
    """

    def __init__(
        self,
        arm: ArmModel,
        flange_from_tool_tip: Transform,
        tool: ToolShape,
        margins: Margins,
        surface_in_base: Floats | None = None,
    ) -> None:
        self._arm = arm
        self._flange_from_tool_tip = flange_from_tool_tip
        self._tool_radius, self._tool_length = tool.radius, 2.0 * tool.half_length
        self._margins = margins
        # Outward normals and offsets of the faces of the convex hull, (f, 4).
        self._faces = None if surface_in_base is None else np.asarray(ConvexHull(surface_in_base).equations)

    def explain(self, points: Floats, joints: npt.ArrayLike) -> Mask:
        """Return which points belong to arm, tool or body, (n,).

        Args:
            points: Points in the robot's base, m, (n, 3).
            joints: Joint positions at the time of the image, rad.
        """
        chain = self._chain(joints)
        radius = self._arm.facts.link_radius + self._margins.arm
        found = np.zeros(len(points), dtype=bool)
        for start, end in pairwise(chain):
            found |= _distance(points, start, end) <= radius
        tip = self._arm.forward(joints) @ self._flange_from_tool_tip
        back = tip.translation + tip.rotation[:, 2] * self._tool_length
        found |= _distance(points, tip.translation, back) <= self._tool_radius + self._margins.arm
        found |= _distance(points, chain[-1], back) <= radius
        if self._faces is not None and len(points):
            outside = points @ self._faces[:, :3].T + self._faces[:, 3]
            found |= outside.max(axis=1) <= self._margins.body
        return found

    def _chain(self, joints: npt.ArrayLike) -> Floats:
        """Return the origins of base, joints and flange in the base, m, (n, 3)."""
        origins = self._arm.joint_origins(joints)
        flange = self._arm.forward(joints).translation
        return np.concatenate((np.zeros((1, 3)), origins, flange[None, :]))


def _distance(points: Floats, start: Floats, end: Floats) -> Floats:
    """Return the distances of points from a line segment, m, (n,)."""
    along = end - start
    length = float(along @ along)
    share = np.clip((points - start) @ along / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(points))
    return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))
