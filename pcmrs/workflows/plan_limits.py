"""How near to its planned pose a guided tool stays, and how fast it may come to the edge of that. Pure."""

from __future__ import annotations

import math

import numpy as np

from pcmrs.messages.teleop import Limit
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.settings import TeleoperationSettings

MARGINS: tuple[Limit, ...] = ("height", "range", "turn")
"""What the margins of `PlanLimits.margins` are of, in order."""

EDGE = (1e-4, 1e-4, 1e-3)
"""A tool with less margin than this counts as at the limit, m, m and rad."""


class PlanLimits:
    """Bounds on pose and twist of a tool in the frame of its planned pose, whose +z points away from the body.

    The tool point stays above the planned contact and near the planned place, the tool is turned little; towards each
    of these bounds it is never faster than it can brake before it.

    Args:
        settings: Of teleoperation.
    """

    def __init__(self, settings: TeleoperationSettings) -> None:
        self._settings = settings
        self._turn = math.radians(settings.turn_deg)

    def margins(self, plan_from_tool: Transform) -> Floats:
        """What is left until each bound, m, m and rad, (3,), as in `MARGINS`; negative beyond it."""
        place = plan_from_tool.translation
        away, turned = np.linalg.norm(place), np.linalg.norm(plan_from_tool.rotvec)
        return np.array((place[2], self._settings.range - away, self._turn - turned))

    def met(self, plan_from_tool: Transform) -> Limit | None:
        """The bound that the tool is at, if any."""
        left = self.margins(plan_from_tool) - EDGE
        return next((name for name, margin in zip(MARGINS, left, strict=True) if margin < 0.0), None)

    def bounded(self, plan_from_tool: Transform, twist: Floats, period: float) -> Floats:
        """The twist, (6,), in the tool's frame, without what would lead over a bound.

        Args:
            plan_from_tool: Where the tool is.
            twist: m/s and rad/s.
            period: For which it holds, s.
        """
        settings = self._settings
        height, reach, turn = self.margins(plan_from_tool).tolist()
        velocity = plan_from_tool.rotation @ twist[:3]
        fastest = _brakes_within(reach, settings.linear_acceleration, period)
        velocity = _slowed(velocity, _direction(plan_from_tool.translation), fastest)
        fastest = _brakes_within(height, settings.linear_acceleration, period)
        velocity = _slowed(velocity, np.array((0.0, 0.0, -1.0)), fastest)
        fastest = _brakes_within(turn, settings.angular_acceleration, period)
        spin = _slowed(twist[3:], _direction(plan_from_tool.rotvec), fastest)
        return np.concatenate((plan_from_tool.rotation.T @ velocity, spin))

    def allow(self, before: Transform, after: Transform) -> bool:
        """Whether a tool may go from one pose to the next: within the bounds, or where it is beyond one, back."""
        least = np.minimum(self.margins(before), 0.0)
        return bool(np.all(self.margins(after) >= least - 1e-9))


def _brakes_within(margin: float, acceleration: float, period: float) -> float:
    """Greatest speed held for one `period` and braked from then within `margin`: v T + v² / 2a = margin."""
    if margin <= 0.0:
        return 0.0
    return acceleration * (math.sqrt(period**2 + 2.0 * margin / acceleration) - period)


def _slowed(velocity: Floats, direction: Floats, fastest: float) -> Floats:
    """A velocity (3,) that is no faster than `fastest` along a unit vector, (3,)."""
    excess = float(velocity @ direction) - fastest
    return velocity - excess * direction if excess > 0.0 else velocity


def _direction(vector: Floats) -> Floats:
    """The unit vector along one, (3,); zero for none."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else vector
