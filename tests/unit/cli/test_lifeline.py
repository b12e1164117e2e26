"""A process that the daemon starts gets its configuration in one line, or says that it is none."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.cli.lifeline import inherited, inherited_table
from pcmrs.errors import ConfigurationError
from pcmrs.settings import Inherited, Settings, read_settings


def test_the_line_of_the_daemon_holds_its_settings_and_key() -> None:
    settings = read_settings(None, ["cell.name=other", "robot.model=iiwa7"])
    line = msgspec.json.encode(Inherited(settings=settings, device_key=b"\x00key")) + b"\n"
    found = inherited(line)
    assert (found.settings, found.device_key) == (settings, b"\x00key")
    assert msgspec.convert(inherited_table(line), Settings) == settings


@pytest.mark.parametrize(
    "line", [b"", b"\n", b"nonsense\n", b"[]", b'{"settings": 1}', b'{"settings": ' + b"[" * 100_000]
)
def test_any_other_line_is_no_configuration(line: bytes) -> None:
    for read in (inherited, inherited_table):
        with pytest.raises(ConfigurationError, match="Standard input is not a configuration"):
            read(line)
