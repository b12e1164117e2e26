"""Keys at a terminal move the tool while they repeat."""

from __future__ import annotations

import asyncio
import os
import pty
import sys
import termios

import pytest

from pcmrs.messages.teleop import AT_REST
from pcmrs.teleop.demand import Demand, Mapping
from pcmrs.teleop.devices import open_device
from pcmrs.teleop.keyboard import AXES, CLUTCH_HELD, HELD, Keys

MAPPING = Mapping(linear=0.02, angular=0.2, dead_zone=0.1)


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
