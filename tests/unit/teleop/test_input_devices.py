"""What hands do at a device, and what is asked for then."""

from __future__ import annotations

import asyncio
import io
import os
import pty
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError
from pcmrs.messages.teleop import AT_REST
from pcmrs.teleop.controllers import (
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
from pcmrs.teleop.devices import open_device
from pcmrs.teleop.keyboard import AXES, CLUTCH_HELD, HELD, Keys
from pcmrs.teleop.twist_script import read_script

MAPPING = Mapping(linear=0.02, angular=0.2, dead_zone=0.1)
deflections = st.floats(-1.5, 1.5)


@given(st.lists(deflections, min_size=6, max_size=6), st.floats(0.0, 0.9))
def test_untouched_device_asks_for_rest_and_none_for_overspeed(deflection: list[float], dead_zone: float) -> None:
    twist = Mapping(0.02, 0.2, dead_zone).twist(deflection)
    for each, given_, full in zip(twist, deflection, (0.02,) * 3 + (0.2,) * 3, strict=True):
        assert abs(each) <= full * (1 + 1e-12)
        assert each == 0.0 if abs(given_) <= dead_zone else each * given_ > 0.0 or abs(given_) - dead_zone < 1e-9
    assert Mapping(0.02, 0.2, dead_zone).twist([1.0] * 6) == pytest.approx((0.02,) * 3 + (0.2,) * 3)


@pytest.mark.parametrize("key", AXES)
def test_a_key_moves_the_tool_for_as_long_as_it_repeats(key: str) -> None:
    keys, axis, direction = Keys(MAPPING), *AXES[key]
    for repeat in range(5):
        keys.press(key, 10.0 + repeat * 0.033)
    asked = keys.demand(10.2)
    assert asked.clutch
    assert [number for number, value in enumerate(asked.twist) if value] == [axis]
    assert asked.twist[axis] * direction == pytest.approx(0.02 if axis < 3 else 0.2)
    last = 10.0 + 4 * 0.033
    assert keys.demand(last + HELD) == Demand(AT_REST, clutch=True)
    assert keys.demand(last + CLUTCH_HELD) == Demand()


def test_space_stops_once_q_leaves_and_a_wrong_key_lets_go() -> None:
    keys = Keys(MAPPING)
    keys.press("w", 1.0)
    keys.press("x", 1.01)
    assert keys.demand(1.02) == Demand()
    keys.press("w", 2.0)
    keys.press(" ", 2.01)
    assert keys.demand(2.02) == Demand(stop=True)
    assert keys.demand(2.03) == Demand()
    keys.press("q", 3.0)
    assert keys.demand(3.0).leave


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


def test_a_script_says_when_and_ends(tmp_path: Path) -> None:
    file = tmp_path / "script.txt"
    file.write_text("# up, then rest\n0.5 0 0 0.01 0 0 0\n\n1.5 open\n2 0 0 0 0 0 0.1  # turn\n3 open\n")
    script = read_script(file)
    up, turn = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)
    asked = {100.0: Demand(), 100.6: Demand(up, clutch=True), 101.6: Demand(), 102.9: Demand(turn, clutch=True)}
    assert {now: script.demand(now) for now in asked} == asked
    assert script.demand(103.0).leave


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("0 1 2 3", "line 1"),
        ("0 open\n0 open", "line 2"),
        ("0 open\n\n1 0 0 0 0 0 nan", "line 3"),
        ("-1 open", "line 1"),
        ("0 0 open 0 0 0 0", "line 1"),
        ("# nothing", "no line"),
    ],
)
def test_a_script_that_cannot_be_meant_is_refused_with_its_line(tmp_path: Path, text: str, what: str) -> None:
    file = tmp_path / "script.txt"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=what):
        read_script(file)


async def test_the_terminal_is_as_before_after_the_keyboard(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal, os.fdopen(ours, "wb", buffering=0) as hands:
        monkeypatch.setattr(sys, "stdin", terminal)
        before = termios.tcgetattr(terminal.fileno())
        with open_device("keyboard", MAPPING) as keyboard:
            hands.write(b"q")
            while not keyboard.demand(0.0).leave:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
        assert termios.tcgetattr(terminal.fileno()) == before


async def test_missing_item_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "evdev", None)
    with pytest.raises(ConfigurationError, match="install the extra teleop"), open_device("gamepad", MAPPING):
        pass
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(ConfigurationError, match="terminal"), open_device("keyboard", MAPPING):
        pass


class KernelDevice:
    """Stands in for an input device of evdev."""

    def __init__(self, able: dict[int, list[Any]]) -> None:
        self.able, self.closed = able, False
        self.fd, self.hands = os.pipe()
        self.unplugged = False

    def capabilities(self) -> dict[int, list[Any]]:
        return self.able

    def read(self) -> Iterator[SimpleNamespace]:
        if self.unplugged:
            raise OSError("No such device")
        for kind, code, value in zip(*[iter(os.read(self.fd, 3))] * 3, strict=True):
            yield SimpleNamespace(type=kind, code=code, value=value)

    def close(self) -> None:
        self.closed = True
        os.close(self.fd)
        os.close(self.hands)


async def test_matching_device_is_read_until_it_is_unplugged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It has all axes and buttons that are needed."""
    mouse, other = KernelDevice({EV_KEY: [0x110], EV_REL: [X, Y]}), KernelDevice({EV_KEY: [0x110]})
    axis = SimpleNamespace(min=0, max=200)
    pad = KernelDevice({EV_KEY: [EAST, SHOULDER_LEFT, START], EV_ABS: [(code, axis) for code in GAMEPAD.axes]})
    devices = {"/dev/input/event0": mouse, "/dev/input/event1": pad}
    evdev = SimpleNamespace(list_devices=lambda: list(devices), InputDevice=devices.__getitem__)
    monkeypatch.setitem(sys.modules, "evdev", evdev)
    with open_device("gamepad", MAPPING) as gamepad:
        assert mouse.closed
        os.write(pad.hands, bytes((EV_ABS, X, 200)))
        pad.unplugged = True
        os.write(pad.hands, bytes(3))
        while not gamepad.demand(0.0).leave:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    assert pad.closed
    evdev.list_devices, evdev.InputDevice = lambda: ["/dev/input/event0"], lambda _: other
    with pytest.raises(ConfigurationError, match="No SpaceMouse"), open_device("spacemouse", MAPPING):
        pass
    assert other.closed
