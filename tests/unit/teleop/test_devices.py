"""Input devices are opened by name, and a missing package or terminal is named."""

from __future__ import annotations

import io
import sys

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.teleop.demand import Mapping
from pcmrs.teleop.devices import open_device

MAPPING = Mapping(linear=0.02, angular=0.2, dead_zone=0.1)


async def test_missing_item_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "evdev", None)
    with pytest.raises(ConfigurationError, match="install the extra teleop"), open_device("gamepad", MAPPING):
        pass
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(ConfigurationError, match="terminal"), open_device("keyboard", MAPPING):
        pass
