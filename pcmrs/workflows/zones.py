"""Zones of a cell: defined by its settings, placed by the tracked poses of body and tracker."""

from __future__ import annotations

from functools import lru_cache
from math import hypot, radians

import numpy as np
import numpy.typing as npt

from pcmrs.formats.mesh import Mesh
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.collision import Solid, box, hull
from pcmrs.kinematics.cone import ApproachCone
from pcmrs.kinematics.sampled_clearance import BOUND, SampledClearance, sample_clearance
from pcmrs.kinematics.zones import SIGHT_OF_BODY, SIGHT_OF_TOOL, ToolShape, Zone, ZoneModel
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import ProcedureSettings, ToolSettings, ZoneSettings

BODY = "body"


class CellZones:
    """Zones that the arm keeps out of in one cell.

    Args:
        facts: Facts of the arm.
        mounting: Calibrated poses of the tool.
        settings: Settings of the procedure.
        surface: Surface of the body; None without a body to keep away from.

    Attributes:
        model: Model that computes the distances.
        limits: Least distance of each pair of `model` near the target, m, (P,). Tool and mount may touch the body.
        limits_afar: Least distances away from the target, m, (P,). Tool and mount keep off the body like all links.
        retreat_limits: Least distances on a retreat, m, (P,), which needs no line of sight.
        cone: Cone through which the tool approaches its target.

    Raises:
        GeometryError: The surface has no volume.
    """

    def __init__(self, facts: ArmFacts, mounting: Mounting, settings: ProcedureSettings, surface: Mesh | None) -> None:
        zones, flange_from_tool_tip = settings.zones, mounting.flange_from_tool_tip
        self._facts = facts
        self._tool_reach = _tool_reach(flange_from_tool_tip, zones.tool)
        self.model = ZoneModel(
            facts,
            flange_from_tool_tip,
            ToolShape(zones.tool.radius, zones.tool.half_length),
            _zones(settings, surface),
            link_margin=zones.link_margin,
            sight_radius=zones.sight_radius,
            # The tracker sees the marker body, 9 cm from the contact point.
            marker_in_flange=mounting.flange_from_tool_marker.translation,
        )
        for fixed in zones.boxes:
            self.model.place(fixed.name, Transform.identity())
        self.limits = self.model.limits
        sights = self.model.pairs_of_zone(SIGHT_OF_TOOL) | self.model.pairs_of_zone(SIGHT_OF_BODY)
        self.retreat_limits = np.where(sights, -np.inf, self.limits)
        self._of_body = self.model.pairs_of_zone(BODY)
        self._has_body = surface is not None
        self.limits_afar = np.where(self._of_body, zones.body_margin, self.limits)
        self.cone = _cone(zones, settings.placement.nudge_limit_mm / 1000.0)

    def place_body(self, base_from_image: Transform) -> None:
        """Place the body by the pose of its image in the robot's base. Without a surface this has no effect."""
        if self._has_body:
            self.model.place(BODY, base_from_image)

    def sample_clearance(self, positions: npt.ArrayLike) -> SampledClearance:
        """Return the sampled distances along a motion with joint positions rad, (N, n)."""
        return sample_clearance(self.model, self._facts, self._tool_reach, positions)

    def limits_towards(self, base_from_target: Transform, points: Floats) -> Floats:
        """Return the least distance of each pair on the way to a target, m, (L, P).

        The tool may touch the body as near to the target as the cone applies.

        Args:
            base_from_target: Planned pose of the tool in the robot's base.
            points: Tool points in the robot's base, m, (L, 3).
        """
        near = np.linalg.norm(points - base_from_target.translation, axis=1) < self.cone.height
        return np.where(near[:, None], self.limits, self.limits_afar)

    def near_body(self, postures: Floats, distance: float) -> npt.NDArray[np.bool_]:
        """Return a mask of the postures at which arm or tool are near the body, (K,).

        Args:
            postures: Joint positions, rad, (K, n).
            distance: Distance from the body within which they are near, m.
        """
        if not self._has_body:
            return np.zeros(len(postures), dtype=bool)
        nearest = np.array([self.model.distances(q)[self._of_body].min() for q in postures])
        # Between two samples, the arm may come nearer by the bound.
        return nearest - BOUND < distance


def _tool_reach(flange_from_tool: Transform, tool: ToolSettings) -> float:
    """Return the greatest distance of any point of the tool from the flange, for any direction of its axis, m."""
    return float(np.linalg.norm(flange_from_tool.translation)) + hypot(tool.radius, 2.0 * tool.half_length)


def _zones(settings: ProcedureSettings, surface: Mesh | None) -> list[Zone]:
    margins = settings.zones
    found = [Zone(b.name, box(b.size, b.pose.transform()), margins.box_margin) for b in margins.boxes]
    if surface is not None:
        found.append(Zone(BODY, _hull(surface.vertices.tobytes()), margins.body_margin, tool_may_touch=True))
    return found


@lru_cache(maxsize=4)
def _hull(vertices: bytes) -> Solid:
    """Return the hull of vertices (N, 3), m, computed once for all cells of a process with the same body."""
    return hull(np.frombuffer(vertices).reshape(-1, 3))


def _cone(zones: ZoneSettings, radius: float) -> ApproachCone:
    """Return the approach cone.

    Its radius at the target is the limit of the nudges, because nudges belong to the plan.
    """
    return ApproachCone(radians(zones.cone_half_angle_deg), zones.cone_height, radius, zones.depth_limit)
