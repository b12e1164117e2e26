"""SpaceMouse and gamepad: axes, clutch and buttons."""

from __future__ import annotations

import pytest

from pcmrs.messages.teleop import AT_REST
from pcmrs.teleop._controllers import (
    BUTTON_0,
    BUTTON_1,
    EAST,
    EV_ABS,
    EV_KEY,
    EV_REL,
    GAMEPAD,
    RX,
    RY,
    SHOULDER_LEFT,
    SPACEMOUSE,
    START,
    ControllerState,
    X,
    Y,
    Z,
)
from pcmrs.teleop.demand import Demand, Mapping

MAPPING = Mapping(linear=0.02, angular=0.2, dead_zone=0.1)


def test_spacemouse_moves_only_with_its_clutch_held() -> None:
    """It forgets what is not repeated."""
    mouse = ControllerState(SPACEMOUSE, MAPPING, {})
    mouse.take(EV_REL, X, 350, 0.0)
    assert mouse.demand(0.01) == Demand()
    mouse.take(EV_KEY, BUTTON_0, 1, 0.02)
    assert mouse.demand(0.03).twist == pytest.approx((0.02, 0, 0, 0, 0, 0))
    mouse.take(EV_REL, Z, -350, 0.09)
    assert mouse.demand(0.15).twist == pytest.approx((0, 0, 0.02, 0, 0, 0)), "the kernel tells of no relative zero"
    mouse.take(EV_KEY, BUTTON_0, 0, 0.16)
    assert mouse.demand(0.17) == Demand()
    mouse.take(EV_KEY, BUTTON_1, 1, 0.2)
    assert mouse.demand(0.2).stop
    mouse.lose()
    assert mouse.demand(0.3) == Demand(leave=True)


def test_gamepad_axes_have_their_own_ranges() -> None:
    pad = ControllerState(GAMEPAD, MAPPING, {X: (0, 255), Y: (0, 255), RX: (-32768, 32767), RY: (-32768, 32767)})
    pad.take(EV_KEY, SHOULDER_LEFT, 1, 0.0)
    for code in (X, Y):
        pad.take(EV_ABS, code, 128, 0.0)
    assert pad.demand(0.0) == Demand(AT_REST, clutch=True), "the middle of an even range is in the dead zone"
    pad.take(EV_ABS, Y, 0, 0.0)
    pad.take(EV_ABS, RY, -32768, 0.0)
    assert pad.demand(99.0).twist == pytest.approx((0, 0.02, 0.02, 0, 0, 0))
    pad.take(EV_KEY, EAST, 1, 0.0)
    pad.take(EV_KEY, START, 1, 0.0)
    assert (pad.demand(0.0).stop, pad.demand(0.0).leave) == (True, True)
