"""Calls of device methods by name: what each method takes and returns, and how a device is asked."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import cache
from typing import Any, get_type_hints

import msgspec

from pcmrs.devices.protocols import Emg, Pointer, RobotDriver, Scene, StimulatorDriver, TrackerDriver
from pcmrs.errors import PayloadError

PROTOCOLS: dict[str, type] = {
    "robot": RobotDriver,
    "tracker": TrackerDriver,
    "pointer": Pointer,
    "scene": Scene,
    "stimulator": StimulatorDriver,
    "emg": Emg,
}
"""Device to what its driver implements; those of its methods that are coroutines can be called over a link."""


@cache
def methods_of(device: str) -> Mapping[str, Mapping[str, Any]]:
    """Method of a device to the types of its arguments, in their order, and of its ``return``; a tracker has none."""
    members = {name: value for each in reversed(PROTOCOLS[device].__mro__) for name, value in vars(each).items()}
    found = {name: value for name, value in members.items() if inspect.iscoroutinefunction(value)}
    return {name: get_type_hints(value) for name, value in found.items()}


async def call_method(name: str, device: Any, method: str, arguments: Mapping[str, Any]) -> Any:
    """Calls a method of a device with arguments as they came over a link, and returns its result.

    Args:
        name: Of the device, in `PROTOCOLS`.
        device: That is asked.
        method: Of its protocol.
        arguments: Name to value, as plain data.

    Raises:
        PayloadError: There is no such method, or it does not take these arguments.
        PcmrsError: What the device raises.
    """
    hints = methods_of(name).get(method)
    if hints is None:
        raise PayloadError(f"There is no method {method!r}; there are {', '.join(methods_of(name))}.")
    wanted = {each: kind for each, kind in hints.items() if each != "return"}
    if set(arguments) != set(wanted):
        raise PayloadError(f"{method} takes {list(wanted)}, not {list(arguments)}.")
    try:
        converted = {each: msgspec.convert(arguments[each], kind) for each, kind in wanted.items()}
    except msgspec.ValidationError as error:
        raise PayloadError(f"{method}: {error}.") from error
    return await getattr(device, method)(**converted)
