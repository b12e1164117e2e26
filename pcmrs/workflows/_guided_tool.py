"""A tool that a teleoperator guides: its bounds near the planned pose, and the joints that move it within them."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.track import track
from pcmrs.kinematics.zones import MOUNT, TOOL
from pcmrs.messages.teleop import Limit
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows._setpoints import limit_twist
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.settings import TeleoperationSettings
from pcmrs.workflows.zones import BODY

MARGIN_NAMES: tuple[Limit, ...] = ("height", "range", "turn")
"""Names of the bounds in the order of `PlanLimits.margins`."""

LIMIT_TOLERANCE = (1e-4, 1e-4, 1e-3)
"""Margins below which a tool counts as at the limit, m, m and rad."""


class PlanLimits:
    """Bounds on pose and twist of a tool in the frame of its planned pose, whose +z axis points away from the body.

    The tool point stays above the planned contact and near the planned place, and the tool is turned only a little.
    Towards each of these bounds it is never faster than it can brake before it.

    Args:
        settings: Settings of teleoperation.
    """

    def __init__(self, settings: TeleoperationSettings) -> None:
        self._settings = settings
        self._turn = math.radians(settings.turn_deg)

    def margins(self, plan_from_tool: Transform) -> Floats:
        """Return the distances to the bounds, m, m and rad, (3,); negative beyond them.

        They are in the order of `MARGIN_NAMES`.
        """
        place = plan_from_tool.translation
        offset, turned = np.linalg.norm(place), np.linalg.norm(plan_from_tool.rotvec)
        return np.array((place[2], self._settings.range - offset, self._turn - turned))

    def met(self, plan_from_tool: Transform) -> Limit | None:
        """Return the bound that the tool is at, if any."""
        remaining = self.margins(plan_from_tool) - LIMIT_TOLERANCE
        return next((name for name, margin in zip(MARGIN_NAMES, remaining, strict=True) if margin < 0.0), None)

    def bounded(self, plan_from_tool: Transform, twist: Floats, period: float) -> Floats:
        """Return a twist in the tool's frame, (6,), without the parts that would lead over a bound.

        Args:
            plan_from_tool: Present pose of the tool in the frame of the plan.
            twist: Twist in the tool's frame: m/s and rad/s, (6,).
            period: Time for which the twist holds, s.
        """
        settings = self._settings
        height, reach, turn = self.margins(plan_from_tool).tolist()
        velocity = plan_from_tool.rotation @ twist[:3]
        fastest = _brakes_within(reach, settings.linear_acceleration, period)
        velocity = _slowed(velocity, _direction(plan_from_tool.translation), fastest)
        fastest = _brakes_within(height, settings.linear_acceleration, period)
        velocity = _slowed(velocity, np.array((0.0, 0.0, -1.0)), fastest)
        # A rotation vector is the same in the frame of the plan and in that of the tool.
        fastest = _brakes_within(turn, settings.angular_acceleration, period)
        spin = _slowed(twist[3:], _direction(plan_from_tool.rotvec), fastest)
        return np.concatenate((plan_from_tool.rotation.T @ velocity, spin))

    def allow(self, before: Transform, after: Transform) -> bool:
        """Return True if a tool may go from one pose to the next: within the bounds or, from beyond a bound, back.

        Args:
            before: Present pose of the tool in the frame of the plan.
            after: Next pose of the tool in the frame of the plan.
        """
        # Beyond a bound the margin is negative, and may only grow.
        lowest = np.minimum(self.margins(before), 0.0)
        return bool(np.all(self.margins(after) >= lowest - 1e-9))


def _brakes_within(margin: float, acceleration: float, period: float) -> float:
    """Return the greatest speed for one `period` from which it brakes within `margin`: v T + v² / 2a = margin."""
    if margin <= 0.0:
        return 0.0
    return acceleration * (math.sqrt(period**2 + 2.0 * margin / acceleration) - period)


def _slowed(velocity: Floats, direction: Floats, fastest: float) -> Floats:
    """Return a velocity (3,) that is no faster than `fastest` along a unit vector, (3,)."""
    excess = float(velocity @ direction) - fastest
    return velocity - excess * direction if excess > 0.0 else velocity


def _direction(vector: Floats) -> Floats:
    """Return the unit vector along a vector, (3,); zero for a zero vector."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else vector


class GuidedTool:
    """Integrator of twists into a pose of the tool and the joints that follow it. It moves nothing itself.

    A step over a limit is not made: the tool stops, and may go back. Zones are kept as on any other path. Where the
    tool may touch the body, it comes no nearer to it than at the planned contact. Links that are already nearer may
    only go away.

    Args:
        cell: Cell with the arm at rest and placed zones.
        base_from_plan: Planned pose in the robot's base, including nudges.

    Attributes:
        positions: Desired joint positions, rad, (n,).
        limit: Limit that blocked the last step, if any.

    Raises:
        UnreachableError: The arm cannot go from here to the planned contact.
    """

    def __init__(self, cell: Cell, base_from_plan: Transform) -> None:
        self._cell, self._settings = cell, cell.settings.teleoperation
        self._limits = PlanLimits(self._settings)
        self.positions = cell.posture()
        self._base_from_tool = cell.arm.forward(self.positions) @ cell.flange_from_tool_tip
        # Pairs that may touch the body are limited by their distances at the planned contact, which the arm must be
        # able to reach from here.
        contact = track(cell.arm, cell.flange_for(base_from_plan), self.positions)
        self._at_contact = cell.zones.model.distances(contact)
        self._touching = np.array([pair in ((TOOL, BODY), (MOUNT, BODY)) for pair in cell.zones.model.pairs])
        self._velocity: Floats = np.zeros(6)
        self._base_from_plan = base_from_plan
        self.limit: Limit | None = None

    @property
    def plan_from_tool(self) -> Transform:
        """Pose of the tool in the frame of its planned pose."""
        return self._base_from_plan.inverse() @ self._base_from_tool

    def begin(self) -> None:
        """Start from the present posture of the arm."""
        self.positions = self._cell.posture()
        self._base_from_tool = self._cell.arm.forward(self.positions) @ self._cell.flange_from_tool_tip
        self._velocity = np.zeros(6)

    def set_plan(self, base_from_plan: Transform) -> None:
        """Take the present planned pose in the robot's base. The zones must be placed accordingly."""
        self._base_from_plan = base_from_plan

    def advance(self, twist: Floats, scale: float, elapsed: float) -> Floats:
        """Move on with a twist, and return the joint velocities of this step, rad/s, (n,).

        Args:
            twist: Desired twist in the tool's frame: m/s and rad/s, (6,). It is shortened to the speed limits.
            scale: Share of the speed limits that is available, 0 to 1.
            elapsed: Time since the last call, s.
        """
        settings, pose = self._settings, self.plan_from_tool
        desired = scale * limit_twist(twist, settings.linear_velocity, settings.angular_velocity)
        desired = self._limits.bounded(pose, desired, elapsed)
        max_change = settings.linear_acceleration * elapsed, settings.angular_acceleration * elapsed
        changed = self._velocity + limit_twist(desired - self._velocity, *max_change)
        self._velocity = self._limits.bounded(pose, changed, elapsed)
        self.limit = self._limits.met(pose) if np.any(twist) else None
        before = self.positions
        if np.any(self._velocity):
            self._step(self._velocity * elapsed)
        return np.asarray((self.positions - before) / elapsed)

    def _step(self, step: Floats) -> None:
        """Move by a step (6,), m and rad, if nothing blocks it; otherwise stop."""
        base_from_tool = self._base_from_tool @ Transform.from_rotvec(step[:3], step[3:])
        positions, blocked_by = self._solve(base_from_tool)
        if blocked_by is None:
            self._base_from_tool, self.positions = base_from_tool, positions
        else:
            self._velocity, self.limit = np.zeros(6), self.limit or blocked_by

    def _solve(self, base_from_tool: Transform) -> tuple[Floats, Limit | None]:
        """Return the joint positions for a pose of the tool, and the limit that blocks it, if any."""
        plan_from_tool = self._base_from_plan.inverse() @ base_from_tool
        if not self._limits.allow(self.plan_from_tool, plan_from_tool):
            return self.positions, self._limits.met(plan_from_tool) or "range"
        try:
            positions = track(self._cell.arm, self._cell.flange_for(base_from_tool), self.positions)
        except UnreachableError:
            return self.positions, "reach"
        return positions, self._blocking_zone(positions, base_from_tool)

    def _blocking_zone(self, positions: Floats, base_from_tool: Transform) -> Literal["zone"] | None:
        zones = self._cell.zones
        limits = zones.limits_towards(self._base_from_plan, base_from_tool.translation[None])[0]
        limits = self._with_contact(limits)
        before, after = zones.model.distances(self.positions), zones.model.distances(positions)
        # A pair below its limit may move apart, so that the tool can leave a zone.
        nearer = bool(np.any((after < limits) & (after < before)))
        return "zone" if nearer or self._leaves_cone(base_from_tool) else None

    def _leaves_cone(self, base_from_tool: Transform) -> bool:
        """Return True if the tool point leaves the approach cone, or goes farther out of it."""
        points = np.array((self._base_from_tool.translation, base_from_tool.translation))
        before, after = self._cell.zones.cone.excess(self._base_from_plan, points).tolist()
        return bool(after > 0.0 and after > before)

    def _with_contact(self, limits: npt.NDArray[np.float64]) -> Floats:
        """Return the limits of all pairs, m, (P,).

        Pairs that may touch may come as near as at the planned contact.
        """
        return np.where(self._touching & np.isinf(limits), self._at_contact, limits)
