"""Distances of an arm's links, and of the tool that it carries, from each other and from zones to keep out of.

Links are capsules from joint to joint with the radius that they have in the simulation. coal computes all distances, in
one call by Pinocchio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.collision import Solid, capsule, cylinder, pose_between, se3
from pcmrs.kinematics.limits import joint_array
from pcmrs.kinematics.urdf import urdf
from pcmrs.spatial import Floats, Transform

__all__ = ["Clearance", "ToolShape", "Zone", "ZoneModel"]

FAR_AWAY = pinocchio.SE3(np.eye(3), np.array((0.0, 0.0, -1000.0)))
"""Pose of a zone whose place is not known: too far away to matter."""
SIGHT_OF_TOOL, SIGHT_OF_BODY = "sight_of_tool", "sight_of_body"
TOOL, MOUNT = "tool", "mount"
MOUNT_RADIUS = 0.03
"""Radius of the mount that joins the tool to the flange, m."""


@dataclass(frozen=True)
class ToolShape:
    """A cylinder about the z axis of the tool's frame, from the tool point along +z, away from the body.

    Attributes:
        radius: Radius, m.
        half_length: Half of its length, m.
    """

    radius: float
    half_length: float


@dataclass(frozen=True, eq=False)
class Zone:
    """A region that the arm keeps out of.

    Attributes:
        name: Name of the zone, unique; refusals show it.
        solid: Shape of the zone, in a frame that `ZoneModel.place` places in the robot's base.
        margin: Least distance of every link from the zone, m.
        tool_may_touch: True if the tool and its mount may come nearer than the margin and touch the zone.
    """

    name: str
    solid: Solid
    margin: float
    tool_may_touch: bool = False


@dataclass(frozen=True)
class Clearance:
    """Distance of a link from a zone or from another link, and its limit; negative where they overlap.

    Attributes:
        link: Name of the link.
        zone: Name of the zone or of the other link.
        distance: Distance between both, m.
        limit: Least allowed distance, m.
    """

    link: str
    zone: str
    distance: float
    limit: float


class ZoneModel:
    """Distances of all pairs of links and zones that matter. Do not share it between threads.

    Every link except the fixed base keeps out of every zone and away from every link that is not its neighbour. Two
    links are neighbours if they are no farther apart than the radius of a link in the zero posture, or do not move
    against each other. The tracker's lines of sight, from its origin to the marker bodies of tool and body, are zones
    once `set_sight_lines` has placed them. The tool and its mount may cut the line to the tool's own marker body.

    Args:
        facts: Facts of the arm.
        flange_from_tool: Pose of the tool's frame in the flange; its +z axis points away from the body.
        tool: Shape of the tool.
        zones: Zones to keep out of; they are far away until they are placed.
        link_margin: Least distance of links from each other, m.
        sight_radius: Least distance of every link from the tracker's lines of sight, m.
        marker_in_flange: Origin of the tool's marker body in the flange, m, (3,).

    Attributes:
        links: Names of the links from the base to the tool.
        pairs: Link and zone, or link and link, of every distance, (P,).
        limits: Least distance of each pair, m, (P,); minus infinity if the pair may touch.
    """

    def __init__(
        self,
        facts: ArmFacts,
        flange_from_tool: Transform,
        tool: ToolShape,
        zones: Sequence[Zone],
        *,
        link_margin: float,
        sight_radius: float,
        marker_in_flange: npt.ArrayLike,
    ) -> None:
        self._joints = len(facts.joints)
        self._model = pinocchio.buildModelFromXML(urdf(facts))
        self._data = self._model.createData()
        self._geometry = pinocchio.GeometryModel()
        self._last_from_tool = se3(facts.joint_from_flange @ flange_from_tool)
        self._marker_in_last = facts.joint_from_flange @ np.asarray(marker_in_flange, dtype=float)
        self._tracker: Floats | None = None
        self._number: dict[str, int] = {}
        self._spheres: dict[str, tuple[Floats, float]] = {}
        self.links = self._add_links(facts, tool)
        self._zones = {zone.name: zone for zone in zones}
        for zone in zones:
            self._add(zone.name, 0, zone.solid)
        for sight in (SIGHT_OF_TOOL, SIGHT_OF_BODY):
            self._add(sight, 0, capsule(np.zeros(3), np.zeros(3), sight_radius))
        for name in (*self._zones, SIGHT_OF_TOOL, SIGHT_OF_BODY):
            self._shape(name).placement = FAR_AWAY
        pair_limits = dict.fromkeys(self._separated_links(facts.link_radius), link_margin) | self._zone_limits(zones)
        for pair in pair_limits:
            self._geometry.addCollisionPair(pinocchio.CollisionPair(*(self._number[name] for name in pair)))
        self.pairs = tuple(pair_limits)
        self.limits = np.array(list(pair_limits.values()))
        self._distances = self._geometry.createData()
        self._sights = {
            name: (self._shape(name).geometry, self._shape(name)) for name in (SIGHT_OF_TOOL, SIGHT_OF_BODY)
        }
        self._results = list(self._distances.distanceResults)  # views, which take longer to make than to read

    def place(self, zone: str, base_from_zone: Transform) -> None:
        """Place a zone.

        Args:
            zone: Name of the zone.
            base_from_zone: Present pose of the zone in the robot's base.
        """
        self._shape(zone).placement = se3(base_from_zone) * self._zones[zone].solid.pose

    def set_sight_lines(self, tracker: npt.ArrayLike, body_ref: npt.ArrayLike) -> None:
        """Place the tracker's lines of sight to the body and to the tool.

        Args:
            tracker: Origin of the tracker in the robot's base, m, (3,).
            body_ref: Origin of the body's reference in the robot's base, m, (3,).
        """
        self._tracker = np.asarray(tracker, dtype=float)
        self._place_sight_line(SIGHT_OF_BODY, self._tracker, np.asarray(body_ref, dtype=float))

    def distances(self, q: npt.ArrayLike) -> Floats:
        """Return the distance of every pair, m, (P,); negative by the depth where they overlap.

        Args:
            q: Joint positions, rad, (n,).

        Raises:
            GeometryError: `q` does not hold one finite number per joint.
        """
        pinocchio.forwardKinematics(self._model, self._data, joint_array(q, self._joints))
        if self._tracker is not None:
            marker = self._data.oMi[self._joints].act(self._marker_in_last)
            self._place_sight_line(SIGHT_OF_TOOL, self._tracker, marker)
        pinocchio.updateGeometryPlacements(self._model, self._data, self._geometry, self._distances)
        pinocchio.computeDistances(self._geometry, self._distances)
        return np.array([found.min_distance for found in self._results])

    def clearance(self, distances: Floats, pair: int) -> Clearance:
        """Return the distance of one pair with its names and its limit.

        Args:
            distances: Distances of all pairs, m, (P,).
            pair: Index of the pair.
        """
        link, zone = self.pairs[pair]
        return Clearance(link, zone, float(distances[pair]), float(self.limits[pair]))

    def pairs_of_zone(self, zone: str) -> npt.NDArray[np.bool_]:
        """Return a mask of the pairs that belong to a zone, (P,)."""
        return np.array([other == zone for _, other in self.pairs])

    def bounding_sphere(self, zone: str) -> Floats:
        """Return a sphere around a hull zone at its present place: x, y, z and radius in the robot's base, m, (4,)."""
        placed = self._shape(zone)
        if zone not in self._spheres:  # of the shape itself, which never changes
            points = np.asarray(placed.geometry.points())
            middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
            self._spheres[zone] = middle, float(np.linalg.norm(points - middle, axis=1).max())
        middle, radius = self._spheres[zone]
        return np.append(placed.placement.act(middle), radius)

    def _shape(self, name: str) -> Any:
        return self._geometry.geometryObjects[self._number[name]]

    def _add(self, name: str, joint: int, solid: Solid) -> None:
        shape = pinocchio.GeometryObject(name, joint, solid.pose, solid.geometry)
        self._number[name] = self._geometry.addGeometryObject(shape)

    def _add_links(self, facts: ArmFacts, tool: ToolShape) -> tuple[str, ...]:
        ends = [*(joint.xyz for joint in facts.joints), facts.flange_xyz]
        names = ["base", *(f"link_{number}" for number in range(1, len(ends)))]
        for number, (name, end) in enumerate(zip(names, ends, strict=True)):
            self._add(name, number, capsule(np.zeros(3), end, facts.link_radius))
        last = len(facts.joints)
        shape = cylinder(tool.radius, tool.half_length, middle=tool.half_length)
        top = self._last_from_tool.act(np.array((0.0, 0.0, 2.0 * tool.half_length)))
        self._add(MOUNT, last, capsule(facts.flange_xyz, top, MOUNT_RADIUS))
        self._add(TOOL, last, Solid(shape.geometry, self._last_from_tool * shape.pose))
        return (*names, MOUNT, TOOL)

    def _separated_links(self, radius: float) -> list[tuple[str, str]]:
        """Return the pairs of links that move against each other and are no neighbours.

        These are the pairs that are more than `radius` (m) apart in the zero posture.
        """
        # The last link, the mount and the tool move as one body.
        rigid = self.links[-3:]
        pairs = [pair for pair in combinations(self.links, 2) if not set(pair) <= set(rigid)]
        for pair in pairs:
            self._geometry.addCollisionPair(pinocchio.CollisionPair(*(self._number[name] for name in pair)))
        data = self._geometry.createData()
        pinocchio.computeDistances(self._model, self._data, self._geometry, data, np.zeros(self._joints))
        results = zip(pairs, data.distanceResults, strict=True)
        separated = [pair for pair, result in results if result.min_distance > radius]
        self._geometry.removeAllCollisionPairs()
        return separated

    def _zone_limits(self, zones: Sequence[Zone]) -> dict[tuple[str, str], float]:
        # The base does not move, so that it cannot avoid anything.
        moving = self.links[1:]
        pair_limits: dict[tuple[str, str], float] = {}
        for zone in zones:
            for link in moving:
                touching = zone.tool_may_touch and link in (TOOL, MOUNT)
                pair_limits[link, zone.name] = -np.inf if touching else zone.margin
        pair_limits |= {(link, SIGHT_OF_BODY): 0.0 for link in moving}
        return pair_limits | {(link, SIGHT_OF_TOOL): 0.0 for link in moving if link not in (TOOL, MOUNT)}

    def _place_sight_line(self, sight: str, tracker: Floats, end: Floats) -> None:
        """Place a line of sight from the tracker to its other end, (3,) each, m, in the robot's base."""
        line, placed = self._sights[sight]
        line.halfLength = math.dist(tracker.tolist(), end.tolist()) / 2.0
        placed.placement = pose_between(tracker, end)
