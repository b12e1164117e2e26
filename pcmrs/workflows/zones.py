"""The zones of a cell: laid out by its settings, placed by what is seen of body and tracker."""

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
from pcmrs.workflows.settings import ProcedureSettings, ToolSettings, ZoneSettings

BODY = "body"


class CellZones:
    """What the arm keeps out of in one cell.

    Args:
        facts: The arm.
        flange_from_coil: Where the tool is.
        settings: Of the procedure.
        surface: Of the body; None where the arm keeps away from none.

    Attributes:
        model: Computes the distances.
        limits: Distance that each pair of `model` keeps, m, (P,); tool and mount may touch the body.
        limits_afar: The same away from the target, where these keep off the body as all links do.
        retreat_limits: The same on the way back, for which nothing need be seen.
        cone: Through which the tool comes to its target.

    Raises:
        GeometryError: The surface encloses nothing.
    """

    def __init__(
        self, facts: ArmFacts, flange_from_coil: Transform, settings: ProcedureSettings, surface: Mesh | None
    ) -> None:
        zones = settings.zones
        self._facts = facts
        self._tool_reach = _tool_reach(flange_from_coil, zones.tool)
        self.model = ZoneModel(
            facts,
            flange_from_coil,
            ToolShape(zones.tool.radius, zones.tool.half_length),
            _zones(settings, surface),
            link_margin=zones.link_margin,
            sight_radius=zones.sight_radius,
        )
        for fixed in zones.boxes:
            self.model.place(fixed.name, Transform.identity())
        self.limits = self.model.limits
        sights = self.model.pairs_of_zone(SIGHT_OF_TOOL) | self.model.pairs_of_zone(SIGHT_OF_BODY)
        self.retreat_limits = np.where(sights, -np.inf, self.limits)
        self._of_body = self.model.pairs_of_zone(BODY)
        self.limits_afar = np.where(self._of_body, zones.body_margin, self.limits)
        self.cone = _cone(zones, settings.placement.nudge_limit_mm / 1000.0)

    def place_body(self, base_from_image: Transform) -> None:
        """Takes where the body is; without a surface that matters to nothing."""
        if self._of_body.any():
            self.model.place(BODY, base_from_image)

    def sample_clearance(self, positions: npt.ArrayLike) -> SampledClearance:
        """A motion past the zones: joint positions rad, (N, n)."""
        return sample_clearance(self.model, self._facts, self._tool_reach, positions)

    def limits_towards(self, base_from_target: Transform, points: Floats) -> Floats:
        """Distance that each pair keeps with the tool at points (L, 3) in the base on its way to a target, m, (L, P).

        The tool may touch the body as near to the target as the cone holds.
        """
        near = np.linalg.norm(points - base_from_target.translation, axis=1) < self.cone.height
        return np.where(near[:, None], self.limits, self.limits_afar)

    def near_body(self, postures: Floats, distance: float) -> npt.NDArray[np.bool_]:
        """At which joint positions rad, (K, n), arm or tool are nearer to the body than `distance`, m, (K,)."""
        if not self._of_body.any():
            return np.zeros(len(postures), dtype=bool)
        nearest = np.array([self.model.distances(q)[self._of_body].min() for q in postures])
        return nearest - BOUND < distance


def _tool_reach(flange_from_tool: Transform, tool: ToolSettings) -> float:
    """No point of the tool is farther from the flange, whichever way its axis points, m."""
    return float(np.linalg.norm(flange_from_tool.translation)) + hypot(tool.radius, 2.0 * tool.half_length)


def _zones(settings: ProcedureSettings, surface: Mesh | None) -> list[Zone]:
    margins = settings.zones
    found = [Zone(b.name, box(b.size, b.pose.transform()), margins.box_margin) for b in margins.boxes]
    if surface is not None:
        found.append(Zone(BODY, _hull(surface.vertices.tobytes()), margins.body_margin, tool_may_touch=True))
    return found


@lru_cache(maxsize=4)
def _hull(vertices: bytes) -> Solid:
    """Worked out once for all cells of a process with the same body; vertices (N, 3), m."""
    return hull(np.frombuffer(vertices).reshape(-1, 3))


def _cone(zones: ZoneSettings, radius: float) -> ApproachCone:
    """As wide at the target as nudges may add up to, since they belong to the plan."""
    return ApproachCone(radians(zones.cone_half_angle_deg), zones.cone_height, radius, zones.depth_limit)
