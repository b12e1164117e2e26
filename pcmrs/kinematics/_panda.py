"""Inverse kinematics in closed form for arms like the Panda, over the position of their last joint.

The pose and joint 7 fix the wrist, where axes 5 and 6 meet. The triangle of shoulder, axis 4 and wrist gives joint 4,
the place of the shoulder seen from the last link gives joints 6 and 5, and the turn that remains is that of the
spherical shoulder: two solutions for each of joints 4, 6 and 2, so eight branches. After Y. He and S. Liu, Analytical
Inverse Kinematics for Franka Emika Panda, International Conference on Control, Mechatronics and Automation (2021), with
both solutions of joint 4.
"""

from __future__ import annotations

from math import atan2, hypot, inf, pi, tau
from operator import itemgetter

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._branches import FORBIDDEN, ROUNDING, Branches, flipped, settled, too_far
from pcmrs.kinematics._geometry import PandaGeometry
from pcmrs.kinematics._posture import (
    DETOUR,
    KEEP_AWAY_COMFORT,
    SINGULAR_COMFORT,
    comfort_penalty,
    sphere_distances,
)
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

_SINGULAR = 1e-12  # sine of joint 2 below which axes 1 and 3 count as parallel, and lateral distance, m
REACH_TOLERANCE = 1e-9  # m beyond the workspace that rounding may produce
_ROUNDING = 1e-9  # cosine beyond 1 that rounding may produce
_STEPS = 40  # steps of the first scan from the seed's joint 7 to each of its limits
_FINE_STEPS = 600  # of the scan for intervals between the limits that the first scan has missed
_SCANS = (30, 30, 30)  # half the number of steps of each further scan around the best position of joint 7
_BRANCHES = Branches(((0, 1, 2, 6, 7, 8, 9), (3, 4, 5, 6, 7, 8, 9)))  # the two of the shoulder
_PLAIN = _BRANCHES.rows[0]


def solve(
    arm: ArmModel,
    geometry: PandaGeometry,
    base_from_flange: Transform,
    seed: Floats,
    joint_margin: float,
    keep_away: Floats | None,
) -> Floats:
    """Return the posture of least cost, rad, (7,).

    Args:
        arm: Model of the arm.
        geometry: Geometry of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        seed: Joint positions to stay close to, rad, (7,).
        joint_margin: Distance to keep from every joint limit, rad.
        keep_away: Spheres as returned by `pcmrs.kinematics._posture.sphere_array`, m, (M, 4), or None.

    Raises:
        UnreachableError: The pose is too far or too near, or no posture keeps the joint limits.
    """
    target = _Target(arm, geometry, base_from_flange, seed, joint_margin, keep_away)
    target.check_reach()
    steps = _STEPS
    score, best = target.best(target.positions(steps), within=True)
    if score >= FORBIDDEN:
        steps = _FINE_STEPS
        score, best = target.best(target.positions(steps), within=False)
    step = max(target.center - target.lower[6], target.upper[6] - target.center) / steps
    for count in _SCANS:
        around = best[6] + step / count * np.arange(-count, count + 1)
        around = np.minimum(np.maximum(around, target.lower[6]), target.upper[6])
        score, best = min((score, best), target.best(around, within=score < FORBIDDEN), key=itemgetter(0))
        step /= count
        if score < FORBIDDEN:  # the last, finer scans only search for a narrow interval between the limits
            return best
    return settled(arm, base_from_flange, target.least_beyond(), joint_margin)


class _Target:
    """A pose to reach, with what the postures that reach it are compared by. Arguments as those of `solve`."""

    def __init__(
        self,
        arm: ArmModel,
        geometry: PandaGeometry,
        base_from_flange: Transform,
        seed: Floats,
        joint_margin: float,
        keep_away: Floats | None,
    ) -> None:
        self._arm, self._geometry = arm, geometry
        self._seed, self._margin, self._keep_away = seed, joint_margin, keep_away
        self.lower, self.upper = (arm.lower + joint_margin).tolist(), (arm.upper - joint_margin).tolist()
        self.center = min(max(float(seed[6]), self.lower[6]), self.upper[6])
        last = geometry.shoulder_from_last(base_from_flange)
        self._turn = last.rotation
        # A point on axis 7 in the shoulder frame, seen along the axes of the last link: the wrist turns about it.
        self._pivot = (last.translation @ last.rotation + (geometry.hand, 0.0, 0.0)).tolist()
        nearest = atan2(self._pivot[1], self._pivot[0])
        self._edges = (nearest, nearest - pi, nearest + pi)

    def positions(self, steps: int) -> Floats:
        """Return positions of joint 7 in `steps` equal steps from that of the seed to either limit, rad, (N,).

        Those at which the wrist is nearest to the shoulder and farthest from it are added: at the edge of the workspace
        only one of them reaches the pose.
        """
        lower, center, upper = self.lower[6], self.center, self.upper[6]
        edges = [q7 for q7 in self._edges if lower <= q7 <= upper]
        share = np.arange(1, steps + 1) / steps
        return np.concatenate((center - share * (center - lower), [center], center + share * (upper - center), edges))

    def best(self, q7: Floats, within: bool) -> tuple[float, Floats]:
        """Return the posture of least cost among all branches, rad, (7,), and its cost, rad.

        The cost is at least `FORBIDDEN` if the posture is beyond a limit or misses the pose, and infinite if there is
        no posture.

        Args:
            q7: Positions of joint 7, rad, (N,).
            within: Leave out early what is beyond the limits or misses the pose.
        """
        values, missing = self._values(q7, within)
        if not values.size:
            return inf, self._seed
        short: Floats = comfort_penalty(
            self._geometry.singular_angles(values.take(_PLAIN, axis=0)), SINGULAR_COMFORT
        ).sum(axis=0)
        if self._keep_away is not None:
            distances = sphere_distances(*self._forearms(values), self._keep_away)
            short += comfort_penalty(distances, KEEP_AWAY_COMFORT).sum(axis=1)
        scores = _BRANCHES.scores(self._arm, values, self._seed, self._margin, DETOUR * short)
        scores += FORBIDDEN * (missing > 0.0) + missing
        branch, column = divmod(int(np.argmin(scores)), scores.shape[1])
        return float(scores[branch, column]), _BRANCHES.posture(values, branch, column)

    def _values(self, q7: Floats, within: bool) -> tuple[Floats, Floats]:
        """Return joint positions as rows of `_BRANCHES`, rad, (10, M), and how far each misses the pose, (M,).

        Scalars along x, y, z are those of the last link, whose z axis is the axis of joint 7. In this frame axis
        6 is along (s7, -c7, 0), and axis 5 along (s6 c7, s6 s7, c6).

        Args:
            q7: Positions of joint 7, rad, (N,).
            within: As in `best`.
        """
        geometry, near = self._geometry, self._seed
        (x, y, z), hand, elbow = self._pivot, geometry.hand, geometry.elbow
        upper_arm, forearm = geometry.upper_arm, geometry.forearm
        c7, s7 = np.cos(q7), np.sin(q7)
        # Vector from shoulder to wrist: along x turned by q7, and along axis 6. Its part along z is that of the pivot.
        ahead, side = c7 * x + s7 * y - hand, s7 * x - c7 * y
        # Joint 4 by the law of cosines in the triangle of shoulder, axis 4 and wrist.
        sides = upper_arm**2 + elbow**2, forearm**2 + elbow**2
        cosine = (ahead * ahead + side * side + (z * z - sum(sides))) / (2.0 * (sides[0] * sides[1]) ** 0.5)
        q4, missing, source = self._solutions(3, geometry.stretched, cosine, within)
        q7, c7, s7, ahead, side = np.array((q7, c7, s7, ahead, side)).take(source, axis=1)
        c4, s4 = np.cos(q4), np.sin(q4)
        # Parts of the vector from shoulder to wrist along axis 5, and across it in the plane of the arm.
        along = forearm - elbow * s4 + upper_arm * c4
        across = elbow * (c4 - 1.0) + upper_arm * s4
        across += _SINGULAR * (across == 0.0)  # if joint 4 is at 0, where links collide
        # Joint 6 brings axis 5 to where it has that part of the vector.
        cosine = along / np.sqrt(ahead * ahead + z * z)
        q6, more, source = self._solutions(5, np.arctan2(ahead, z), cosine, within)
        columns = np.array((q7, c7, s7, ahead, side, missing, q4, c4, s4, along, across))
        q7, c7, s7, ahead, side, missing, q4, c4, s4, along, across = columns.take(source, axis=1)
        c6, s6 = np.cos(q6), np.sin(q6)
        sign = np.sign(across)
        q5 = np.arctan2(sign * side, sign * (c6 * ahead - s6 * z))
        c5, s5 = np.cos(q5), np.sin(q5)
        # The z and y axes after the turns of the shoulder, which leaves its own joints.
        share = s4 / across
        rest = c4 - share * along
        shift = rest * s6 - share * hand
        up = self._turn @ np.array((shift * c7 + share * x, shift * s7 + share * y, rest * c6 + share * z))
        left = self._turn @ np.array((s5 * c6 * c7 - c5 * s7, s5 * c6 * s7 + c5 * c7, -s5 * s6))
        tilt = np.sqrt(up[0] * up[0] + up[1] * up[1])
        q1 = np.where(tilt > _SINGULAR, np.arctan2(up[1], up[0]), near[0])
        c1, s1 = np.cos(q1), np.sin(q1)
        q3 = np.arctan2(tilt * left[2] - up[2] * (c1 * left[0] + s1 * left[1]), c1 * left[1] - s1 * left[0])
        shoulder = np.array((q1, np.arctan2(tilt, up[2]), q3))
        return np.concatenate((shoulder, flipped(shoulder), np.array((q4, q5, q6, q7)))), missing + more

    def _solutions(
        self, joint: int, middle: float | Floats, cosine: Floats, within: bool
    ) -> tuple[Floats, Floats, npt.NDArray[np.intp]]:
        """Return both positions of a joint, `middle` plus and minus an angle, as far as they can be of use.

        Args:
            joint: Index of the joint.
            middle: Middle of the two positions, rad, a number or (N,).
            cosine: Cosine of the angle; beyond 1 the pose is missed, (N,).
            within: As in `best`.

        Returns:
            Positions, rad, (M,); how far the cosine was beyond 1, (M,); and the column from which each follows, (M,).
        """
        excess = np.abs(cosine) - 1.0
        missing = excess * (excess > _ROUNDING)
        angle = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
        lower, upper = self.lower[joint], self.upper[joint]
        positions = np.concatenate((middle + angle, middle - angle))
        positions -= tau * np.rint((positions - (lower + upper) / 2.0) / tau)
        source = np.arange(len(positions))
        if within:
            useful = (positions >= lower - ROUNDING) & (positions <= upper + ROUNDING)
            useful &= np.concatenate((missing, missing)) == 0.0
            source = np.flatnonzero(useful)
        positions, source = positions.take(source), source % len(cosine)
        return positions, missing.take(source), source

    def _forearms(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the positions of elbow and wrist in the base, m, (M, 3) each.

        Args:
            values: Joint positions as rows of `_BRANCHES`, rad, (10, M).
        """
        geometry = self._geometry
        c1, s1, c2, s2, c3, s3 = (part(values[row]) for row in range(3) for part in (np.cos, np.sin))
        beside, above = geometry.elbow, geometry.upper_arm
        level = c2 * c3 * beside + s2 * above
        elbow = np.array((c1 * level - s1 * s3 * beside, s1 * level + c1 * s3 * beside, c2 * above - s2 * c3 * beside))
        c7, s7 = np.cos(values[9]), np.sin(values[9])
        (x, y, z), hand = self._pivot, geometry.hand
        wrist = self._turn @ np.array((x - hand * c7, y - hand * s7, np.full_like(c7, z)))
        base = geometry.base_from_shoulder
        return (elbow.T @ base.rotation.T + base.translation), (wrist.T @ base.rotation.T + base.translation)

    def least_beyond(self) -> Floats:
        """Return the posture that reaches the pose and is the least beyond the limits, also of joint 7, rad, (7,)."""
        q7 = np.concatenate((np.linspace(-pi, pi, 2 * _FINE_STEPS), self._edges))
        values, missing = self._values(q7, within=False)
        values = values[:, missing == 0.0]
        scores = _BRANCHES.scores(self._arm, values, self._seed, self._margin, np.zeros(values.shape[1]))
        branch, column = divmod(int(np.argmin(scores)), scores.shape[1])
        return _BRANCHES.posture(values, branch, column)

    def check_reach(self) -> None:
        """Raise an error if the wrist is too far from the shoulder or too near to it with every position of joint 7.

        Raises:
            UnreachableError: It is; the text says by how much.
        """
        geometry, (x, y, z) = self._geometry, self._pivot
        upper_arm, forearm = hypot(geometry.upper_arm, geometry.elbow), hypot(geometry.forearm, geometry.elbow)
        stretched, folded = upper_arm + forearm, abs(upper_arm - forearm)
        nearest, farthest = (hypot(hypot(x, y) + hand, z) for hand in (-geometry.hand, geometry.hand))
        if nearest > stretched + REACH_TOLERANCE:
            raise too_far(nearest, stretched)
        if farthest < folded - REACH_TOLERANCE:
            raise UnreachableError(
                f"The pose is too near: the wrist would be {farthest:.4f} m from the shoulder, the folded arm reaches "
                f"{folded:.4f} m; move it {(folded - farthest) * 1e3:.1f} mm away.",
                reach=farthest,
                limit=folded,
            )
