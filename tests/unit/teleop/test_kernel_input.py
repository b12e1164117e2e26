"""The first device of the kernel with all axes and buttons is read."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.teleop._controllers import (
    EAST,
    EV_ABS,
    EV_KEY,
    EV_REL,
    GAMEPAD,
    SHOULDER_LEFT,
    START,
    X,
    Y,
)
from pcmrs.teleop.demand import Mapping
from pcmrs.teleop.devices import open_device

MAPPING = Mapping(linear=0.02, angular=0.2, dead_zone=0.1)


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
