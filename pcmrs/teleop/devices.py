"""All input devices by name."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from pcmrs.teleop.demand import InputDevice, Mapping

DEVICES = ("keyboard", "spacemouse", "gamepad", "script")


def open_device(name: str, mapping: Mapping, script: Path | None = None) -> AbstractContextManager[InputDevice]:
    """Open an input device; enter it in the event loop that is to read it.

    Args:
        name: One of `DEVICES`.
        mapping: Converts deflections to twists.
        script: Script file of the device ``script``.

    Raises:
        ConfigurationError: It cannot be read; raised on entering at the latest.
    """
    if script is not None:
        from pcmrs.teleop._twist_script import read_script

        return nullcontext(read_script(script))
    if name == "keyboard":
        from pcmrs.teleop.keyboard import open_keyboard  # for terminals only

        return open_keyboard(mapping)
    from pcmrs.teleop._controllers import GAMEPAD, SPACEMOUSE
    from pcmrs.teleop._kernel_input import open_controller

    return open_controller(SPACEMOUSE if name == "spacemouse" else GAMEPAD, mapping)
