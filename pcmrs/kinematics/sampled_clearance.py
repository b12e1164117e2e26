"""Whether a motion keeps out of the zones, looked at so closely that nothing is missed by more than a stated bound."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.zones import Clearance, ZoneModel
from pcmrs.spatial import Floats

BOUND = 0.005
"""Between two looks no distance falls by more than this below the smaller one that was found, m.

Twice as much for the line of sight to the tool, which moves with the tool.
"""
NOISE = 0.001
"""Shrinking by less than this is noise of the measured posture, m."""


@dataclass(frozen=True, eq=False)
class Violation:
    """Where a motion first comes too near.

    Attributes:
        clearance: Which link, which zone, how near.
        posture: Joint positions there, rad, (n,).
    """

    clearance: Clearance
    posture: Floats


@dataclass(frozen=True, eq=False)
class SampledClearance:
    """A motion as it passes the zones.

    Attributes:
        postures: Looks at it, rad, (L, n): all points of the arm move by less than twice `BOUND` between two.
        distances: Of every pair at each look, m, (L, P).
    """

    postures: Floats
    distances: Floats

    def first_violation(self, zones: ZoneModel, limits: Floats) -> Violation | None:
        """The first look at which a pair is nearer than its limit, m, (P,), or (L, P) where that differs by look."""
        return self._first(zones, limits, self.distances < limits)

    def first_approach(self, zones: ZoneModel, limits: Floats) -> Violation | None:
        """The same for a retreat, which may begin too near: there, distances may only grow."""
        shrinks = np.maximum.accumulate(self.distances, axis=0) - self.distances
        return self._first(zones, limits, (self.distances < limits) & (shrinks > NOISE))

    def _first(self, zones: ZoneModel, limits: Floats, broken: npt.NDArray[np.bool_]) -> Violation | None:
        looks = np.flatnonzero(broken.any(axis=1))
        if not len(looks):
            return None
        look = int(looks[0])
        distances, wanted = self.distances[look], np.broadcast_to(limits, self.distances.shape)[look]
        pair = int(np.argmin(np.where(broken[look], distances - wanted, np.inf)))
        clearance = Clearance(*zones.pairs[pair], float(distances[pair]), float(wanted[pair]))
        return Violation(clearance, self.postures[look])


def look_at(zones: ZoneModel, facts: ArmFacts, tool_reach: float, positions: npt.ArrayLike) -> SampledClearance:
    """Looks at a motion.

    Args:
        zones: With all zones placed.
        facts: The arm.
        tool_reach: Farthest point of the tool from the flange, m.
        positions: Joint positions along the motion, rad, (N, n), between which it is straight in joint space.
    """
    samples = np.asarray(positions, dtype=float)
    # No point moves farther than the sum of each joint's turn times what lies beyond that joint, stretched out.
    steps = np.abs(np.diff(samples, axis=0)) @ _reaches(facts, tool_reach)
    way = np.concatenate(((0.0,), np.cumsum(steps)))
    looks = np.linspace(0.0, way[-1], 1 + ceil(way[-1] / (2.0 * BOUND)))
    at = np.interp(looks, way, np.arange(len(samples)))
    postures = np.column_stack([np.interp(at, np.arange(len(samples)), joint) for joint in samples.T])
    return SampledClearance(postures, np.array([zones.distances(q) for q in postures]))


def _reaches(facts: ArmFacts, tool_reach: float) -> Floats:
    """Length of the arm beyond every joint, stretched out, with the tool, m, (n,)."""
    lengths = [float(np.linalg.norm(joint.xyz)) for joint in facts.joints[1:]]
    beyond = [*lengths, float(np.linalg.norm(facts.flange_xyz)) + tool_reach]
    return np.cumsum(beyond[::-1])[::-1]
