"""Commands that the daemon starts: it hands them its configuration on standard input, whose end is theirs."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import msgspec

from pcmrs.errors import ConfigurationError

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the robot's kinematics.
    from pcmrs.settings import Settings

NICENESS = 10
"""Of what serves neither robot nor procedure: control comes first."""


def settings_from_daemon() -> Settings:
    """The daemon's configuration, one line of JSON. Raises `ConfigurationError`."""
    from pcmrs.settings import Settings

    try:
        return msgspec.json.decode(sys.stdin.buffer.readline(), type=Settings)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ConfigurationError(f"Standard input is no configuration: {error}.") from None
