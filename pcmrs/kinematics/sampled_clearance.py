"""Clearance of a motion from the zones, sampled so densely that no distance is missed by more than a stated bound."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.zones import Clearance, ZoneModel
from pcmrs.spatial import Floats

BOUND = 0.005
"""Greatest drop of a distance between two samples below the smaller of both, m.

For the line of sight to the tool it is twice as much, because that line moves with the tool.
"""
NOISE = 0.001
"""A distance that shrinks by less than this is regarded as noise of the measured posture, m."""


@dataclass(frozen=True, eq=False)
class ClearanceViolation:
    """The first point of a motion that is too near to a zone or a link.

    Attributes:
        clearance: The pair, its distance and its limit.
        posture: Joint positions at that point, rad, (n,).
    """

    clearance: Clearance
    posture: Floats


@dataclass(frozen=True, eq=False)
class SampledClearance:
    """Distances of all pairs along a motion.

    Attributes:
        postures: Sampled postures, rad, (L, n). No point of the arm moves by more than twice `BOUND` between two of
            them.
        distances: Distance of every pair at each sample, m, (L, P).
    """

    postures: Floats
    distances: Floats

    def first_violation(self, zones: ZoneModel, limits: Floats) -> ClearanceViolation | None:
        """Return the first sample at which a pair is nearer than its limit, or None.

        Args:
            zones: Model that the distances were computed with.
            limits: Least distance of each pair, m, (P,), or (L, P) if it differs from sample to sample.
        """
        return self._first(zones, limits, self.distances < limits)

    def first_approach(self, zones: ZoneModel, limits: Floats) -> ClearanceViolation | None:
        """Return the first sample of a retreat at which a pair is below its limit and comes nearer, or None.

        A retreat may start too near; from there on, distances may only grow.

        Args:
            zones: Model that the distances were computed with.
            limits: Least distance of each pair, m, (P,), or (L, P) if it differs from sample to sample.
        """
        shrinks = np.maximum.accumulate(self.distances, axis=0) - self.distances
        return self._first(zones, limits, (self.distances < limits) & (shrinks > NOISE))

    def _first(self, zones: ZoneModel, limits: Floats, broken: npt.NDArray[np.bool_]) -> ClearanceViolation | None:
        samples = np.flatnonzero(broken.any(axis=1))
        if not len(samples):
            return None
        sample = int(samples[0])
        distances, required = self.distances[sample], np.broadcast_to(limits, self.distances.shape)[sample]
        pair = int(np.argmin(np.where(broken[sample], distances - required, np.inf)))
        clearance = Clearance(*zones.pairs[pair], float(distances[pair]), float(required[pair]))
        return ClearanceViolation(clearance, self.postures[sample])


def sample_clearance(
    zones: ZoneModel, facts: ArmFacts, tool_reach: float, positions: npt.ArrayLike
) -> SampledClearance:
    """Return the sampled distances of all pairs along a motion.

    Args:
        zones: Model in which all zones are placed.
        facts: Facts of the arm.
        tool_reach: Distance of the tool's farthest point from the flange, m.
        positions: Joint positions along the motion, rad, (N, n). Between two of them it is straight in joint space.
    """
    given = np.asarray(positions, dtype=float)
    # No point of the arm moves farther than the sum over the joints of |turn| times the length of the arm beyond it.
    steps = np.abs(np.diff(given, axis=0)) @ _lengths_beyond(facts, tool_reach)
    path = np.concatenate(((0.0,), np.cumsum(steps)))
    places = np.linspace(0.0, path[-1], 1 + ceil(path[-1] / (2.0 * BOUND)))
    at = np.interp(places, path, np.arange(len(given)))
    postures = np.column_stack([np.interp(at, np.arange(len(given)), joint) for joint in given.T])
    return SampledClearance(postures, np.array([zones.distances(q) for q in postures]))


def _lengths_beyond(facts: ArmFacts, tool_reach: float) -> Floats:
    """Return the length of the stretched arm beyond each joint, with the tool, m, (n,)."""
    lengths = [float(np.linalg.norm(joint.xyz)) for joint in facts.joints[1:]]
    beyond = [*lengths, float(np.linalg.norm(facts.flange_xyz)) + tool_reach]
    return np.cumsum(beyond[::-1])[::-1]
