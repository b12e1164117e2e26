"""SpaceMouse and gamepad, read from the kernel's input events."""

from __future__ import annotations

from collections.abc import Mapping as Table
from dataclasses import dataclass

from pcmrs.messages.teleop import AT_REST, Twist
from pcmrs.teleop.demand import Demand, Mapping

EV_KEY, EV_REL, EV_ABS = 1, 2, 3
X, Y, Z, RX, RY, RZ = range(6)
"""Codes of the axes, the same for EV_REL and EV_ABS."""
HAT_X, HAT_Y = 16, 17
BUTTON_0, BUTTON_1 = 0x100, 0x101
EAST, SHOULDER_LEFT, START = 0x131, 0x136, 0x13B

FORGOTTEN = 0.1
"""A relative axis sends no event when it comes to rest: it counts as at rest after so long without one, s."""


@dataclass(frozen=True)
class ControllerLayout:
    """Meaning of the axes and buttons of a kind of device.

    Attributes:
        name: Name for people.
        axes: Code to axis of the tool (x, y, z, about x, y, z) and direction.
        clutch: Button that has to be held.
        stop: Button of Stop.
        leave: Button that ends the session; None if there is none.
        full: Value of full deflection of axes that report no range.
    """

    name: str
    axes: Table[int, tuple[int, float]]
    clutch: int
    stop: int
    leave: int | None = None
    full: float = 350.0


SPACEMOUSE = ControllerLayout(
    name="SpaceMouse",
    axes={X: (0, 1.0), Y: (1, -1.0), Z: (2, -1.0), RX: (3, 1.0), RY: (4, -1.0), RZ: (5, -1.0)},
    clutch=BUTTON_0,
    stop=BUTTON_1,
)
"""The cap moves as the tool should move: to the right, away from the person in front of it, up."""

GAMEPAD = ControllerLayout(
    name="gamepad",
    axes={X: (0, 1.0), Y: (1, -1.0), RY: (2, -1.0), HAT_Y: (3, 1.0), HAT_X: (4, 1.0), RX: (5, 1.0)},
    clutch=SHOULDER_LEFT,
    stop=EAST,
    leave=START,
)
"""Left stick along x and y, right stick along z and about it, cross about x and y; clutch at the left shoulder."""


class ControllerState:
    """State of a device, from its events.

    Args:
        layout: Meaning of its axes and buttons.
        mapping: Converts deflections to a twist.
        ranges: Code of an axis to its least and greatest value, if it has a range.
    """

    def __init__(self, layout: ControllerLayout, mapping: Mapping, ranges: Table[int, tuple[float, float]]) -> None:
        self._layout, self._mapping, self._ranges = layout, mapping, ranges
        self._values: dict[int, tuple[float, float]] = {}
        self._clutch = self._stop = self._leave = False

    def take(self, kind: int, code: int, value: int, now: float) -> None:
        """Take an event of the kernel.

        Args:
            kind: Type of the event, such as `EV_KEY`.
            code: Axis or button.
            value: Its value.
            now: Time in s of the monotonic clock.
        """
        if kind == EV_KEY:
            self._press(code, pressed=value != 0)
        elif kind in (EV_REL, EV_ABS) and code in self._layout.axes:
            until = now + FORGOTTEN if kind == EV_REL else float("inf")
            self._values[code] = self._deflection(code, value), until

    def lose(self) -> None:
        """Note that the device has been unplugged."""
        self._clutch, self._leave = False, True

    def demand(self, now: float) -> Demand:
        stop, self._stop = self._stop, False
        return Demand(self._twist(now) if self._clutch else AT_REST, self._clutch, stop, self._leave)

    def _press(self, code: int, *, pressed: bool) -> None:
        if code == self._layout.clutch:
            self._clutch = pressed
        elif code == self._layout.stop and pressed:
            self._stop = True
        elif code == self._layout.leave and pressed:
            self._leave = True

    def _deflection(self, code: int, value: float) -> float:
        least, greatest = self._ranges.get(code, (-self._layout.full, self._layout.full))
        return 2.0 * (value - least) / (greatest - least) - 1.0

    def _twist(self, now: float) -> Twist:
        deflection = [0.0] * 6
        for code, (value, until) in self._values.items():
            axis, direction = self._layout.axes[code]
            deflection[axis] = direction * value if now < until else 0.0
        return self._mapping.twist(deflection)
