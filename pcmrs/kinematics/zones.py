"""How far the links of an arm, and the tool it carries, are from each other and from zones they must keep out of.

Links are capsules from joint to joint, as thick as those of the simulation; all distances are coal's, computed in one
call by Pinocchio.
"""

from __future__ import annotations

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

NOWHERE = pinocchio.SE3(np.eye(3), np.array((0.0, 0.0, -1000.0)))
"""Where a zone is whose place is not known: too far away to matter."""
SIGHT_OF_TOOL, SIGHT_OF_BODY = "sight_of_tool", "sight_of_body"
TOOL, MOUNT = "tool", "mount"
MOUNT_RADIUS = 0.03
"""Of what joins the tool to the flange, m."""


@dataclass(frozen=True)
class ToolShape:
    """A cylinder about the z axis of the tool's frame, from the tool point along +z, away from the body; m."""

    radius: float
    half_length: float


@dataclass(frozen=True, eq=False)
class Zone:
    """What the arm keeps out of.

    Attributes:
        name: Unique, as refusals have it.
        solid: Its shape, in a frame that `ZoneModel.place` places in the robot's base.
        margin: Distance that every link keeps from it, m.
        tool_may_touch: Whether the tool and its mount need not keep it.
    """

    name: str
    solid: Solid
    margin: float
    tool_may_touch: bool = False


@dataclass(frozen=True)
class Clearance:
    """How far a link is from a zone, or from another link, and how far it must be; m, negative where they overlap."""

    link: str
    zone: str
    distance: float
    limit: float


class ZoneModel:
    """The distances of all pairs that matter. Not to be shared between threads.

    Every link but the fixed base keeps out of every zone, and of every link that is no neighbour: that is farther away
    than the radius of a link in the zero posture, and does not only bend about the joint between. What the tracker sees
    along, from its origin to tool and body, is a zone once `look_from` has said where it is; the tool and its mount may
    cut the line to the tool, which carries the markers.

    Args:
        facts: The arm.
        flange_from_tool: Pose of the tool's frame, whose +z points away from the body, back to the flange.
        tool: Its shape.
        zones: What to keep out of; nowhere until they are placed.
        link_margin: Distance that links keep from each other, m.
        sight_radius: How far every link stays from what the tracker sees along, m.

    Attributes:
        links: Names, from the base to the tool.
        pairs: Link and zone, or link and link, of every distance, in order.
        limits: Distance that each pair keeps, m, (P,); minus infinity where it may touch.
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
    ) -> None:
        self._joints = len(facts.joints)
        self._model = pinocchio.buildModelFromXML(urdf(facts))
        self._data = self._model.createData()
        self._geometry = pinocchio.GeometryModel()
        self._last_from_tool = se3(facts.joint_from_flange @ flange_from_tool)
        self._tracker: Floats | None = None
        self._number: dict[str, int] = {}
        self.links = self._add_links(facts, tool)
        self._zones = {zone.name: zone for zone in zones}
        for zone in zones:
            self._add(zone.name, 0, zone.solid)
        for sight in (SIGHT_OF_TOOL, SIGHT_OF_BODY):
            self._add(sight, 0, capsule(np.zeros(3), np.zeros(3), sight_radius))
        for name in (*self._zones, SIGHT_OF_TOOL, SIGHT_OF_BODY):
            self._shape(name).placement = NOWHERE
        wanted = dict.fromkeys(self._apart(facts.link_radius), link_margin) | self._kept_from_zones(zones)
        for pair in wanted:
            self._geometry.addCollisionPair(pinocchio.CollisionPair(*(self._number[name] for name in pair)))
        self.pairs = tuple(wanted)
        self.limits = np.array(list(wanted.values()))
        self._distances = self._geometry.createData()
        self._sights = {
            name: (self._shape(name).geometry, self._shape(name)) for name in (SIGHT_OF_TOOL, SIGHT_OF_BODY)
        }
        self._results = list(self._distances.distanceResults)  # views, which take longer to make than to read

    def place(self, zone: str, base_from_zone: Transform) -> None:
        """Puts a zone where it is now, in the robot's base."""
        self._shape(zone).placement = se3(base_from_zone) * self._zones[zone].solid.pose

    def look_from(self, tracker: npt.ArrayLike, body_ref: npt.ArrayLike) -> None:
        """Takes the origins of the tracker and of the body's reference, in the robot's base, m, (3,)."""
        self._tracker = np.asarray(tracker, dtype=float)
        self._stretch(SIGHT_OF_BODY, self._tracker, np.asarray(body_ref, dtype=float))

    def distances(self, q: npt.ArrayLike) -> Floats:
        """Distance of every pair at joint positions `q`, rad, (n,); m, (P,), negative by as much as they overlap.

        Raises:
            GeometryError: `q` does not hold one finite number per joint.
        """
        pinocchio.forwardKinematics(self._model, self._data, joint_array(q, self._joints))
        if self._tracker is not None:
            base_from_tool = self._data.oMi[self._joints] * self._last_from_tool
            self._stretch(SIGHT_OF_TOOL, self._tracker, base_from_tool.translation)
        pinocchio.updateGeometryPlacements(self._model, self._data, self._geometry, self._distances)
        pinocchio.computeDistances(self._geometry, self._distances)
        return np.array([found.min_distance for found in self._results])

    def clearance(self, distances: Floats, pair: int) -> Clearance:
        """One pair of `distances`, (P,), with its names and its limit."""
        link, zone = self.pairs[pair]
        return Clearance(link, zone, float(distances[pair]), float(self.limits[pair]))

    def of_zone(self, zone: str) -> npt.NDArray[np.bool_]:
        """Which pairs belong to a zone, (P,)."""
        return np.array([other == zone for _, other in self.pairs])

    def ball(self, zone: str) -> Floats:
        """A ball around a zone that is a hull, where that is now: x, y, z and radius in the robot's base, m, (4,)."""
        placed = self._shape(zone)
        points = np.asarray(placed.geometry.points())
        middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
        radius = np.linalg.norm(points - middle, axis=1).max()
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

    def _apart(self, radius: float) -> list[tuple[str, str]]:
        """Pairs of links that move against each other and are no neighbours: a radius apart in the zero posture."""
        rigid = self.links[-3:]
        pairs = [pair for pair in combinations(self.links, 2) if not set(pair) <= set(rigid)]
        for pair in pairs:
            self._geometry.addCollisionPair(pinocchio.CollisionPair(*(self._number[name] for name in pair)))
        data = self._geometry.createData()
        pinocchio.computeDistances(self._model, self._data, self._geometry, data, np.zeros(self._joints))
        apart = [pair for pair, found in zip(pairs, data.distanceResults, strict=True) if found.min_distance > radius]
        self._geometry.removeAllCollisionPairs()
        return apart

    def _kept_from_zones(self, zones: Sequence[Zone]) -> dict[tuple[str, str], float]:
        moving = self.links[1:]
        kept: dict[tuple[str, str], float] = {}
        for zone in zones:
            for link in moving:
                touching = zone.tool_may_touch and link in (TOOL, MOUNT)
                kept[link, zone.name] = -np.inf if touching else zone.margin
        kept |= {(link, SIGHT_OF_BODY): 0.0 for link in moving}
        return kept | {(link, SIGHT_OF_TOOL): 0.0 for link in moving if link not in (TOOL, MOUNT)}

    def _stretch(self, sight: str, tracker: Floats, end: Floats) -> None:
        """Lays a line of sight from the tracker to `end`, (3,) each, in the robot's base."""
        line, placed = self._sights[sight]
        line.halfLength = float(np.linalg.norm(end - tracker)) / 2.0
        placed.placement = pose_between(tracker, end)
