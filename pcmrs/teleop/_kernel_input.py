"""Finds and reads input devices of the kernel, with the package evdev."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from pcmrs.errors import ConfigurationError
from pcmrs.teleop._controllers import EV_ABS, EV_KEY, EV_REL, ControllerLayout, ControllerState
from pcmrs.teleop.demand import Mapping


@contextmanager
def open_controller(layout: ControllerLayout, mapping: Mapping) -> Iterator[ControllerState]:
    """Read the first device that has all axes and buttons of a layout, in the running event loop.

    Args:
        layout: Meaning of its axes and buttons.
        mapping: Converts deflections to a twist.

    Raises:
        ConfigurationError: The package is not installed, or there is no such device that this user may read.
    """
    device, ranges = _find(_evdev(), layout)
    controller, loop = ControllerState(layout, mapping, ranges), asyncio.get_running_loop()

    def read() -> None:
        try:
            for event in device.read():
                controller.take(event.type, event.code, event.value, loop.time())
        except OSError:  # unplugged
            loop.remove_reader(device.fd)
            controller.lose()

    loop.add_reader(device.fd, read)
    try:
        yield controller
    finally:
        loop.remove_reader(device.fd)
        device.close()


def _evdev() -> Any:
    try:
        return import_module("evdev")
    except ImportError:
        text = "SpaceMouse and gamepad are read by the package evdev, which is missing: "
        text += "install the extra teleop (docs/supply.md)."
        raise ConfigurationError(text) from None


def _find(evdev: Any, layout: ControllerLayout) -> tuple[Any, dict[int, tuple[float, float]]]:
    for path in evdev.list_devices():
        device = evdev.InputDevice(path)
        able = device.capabilities()
        ranges = {code: (info.min, info.max) for code, info in able.get(EV_ABS, ()) if info.max > info.min}
        if layout.axes.keys() <= {*able.get(EV_REL, ()), *ranges} and layout.clutch in able.get(EV_KEY, ()):
            return device, ranges
        device.close()
    text = (
        f"No {layout.name} is found among the input devices that this user may read (/dev/input/event*): connect it, "
        "and let the user read it, as members of the group input may."
    )
    raise ConfigurationError(text, device=layout.name)
