"""Calls of device methods by name: argument and return types of each method, and the call itself."""

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
"""Protocol of each device, which its driver implements. Those of its methods that are coroutines can be called."""


@cache
def methods_of(device: str) -> Mapping[str, Mapping[str, Any]]:
    """Return the types of the arguments, in order, and of ``return`` of each method; a tracker has no methods."""
    members = {name: value for each in reversed(PROTOCOLS[device].__mro__) for name, value in vars(each).items()}
    found = {name: value for name, value in members.items() if inspect.iscoroutinefunction(value)}
    return {name: get_type_hints(value) for name, value in found.items()}


async def call_method(name: str, device: Any, method: str, arguments: Mapping[str, Any]) -> Any:
    """Call a method of a device with arguments that arrived over a link, and return its result.

    Args:
        name: Name of the device in `PROTOCOLS`.
        device: The device.
        method: Name of a method of its protocol.
        arguments: Arguments by name, as plain data.

    Raises:
        PayloadError: There is no such method, or it does not take these arguments.
        PcmrsError: The device raised this error.
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
