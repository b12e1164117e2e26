"""Commands that the daemon starts: it hands them its configuration on standard input, whose end is theirs."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import msgspec

from pcmrs.errors import ConfigurationError

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the robot's kinematics.
    from pcmrs.settings import Inherited

NICENESS = 10
"""Of what serves neither robot nor procedure: control comes first."""


def inherited() -> Inherited:
    """What the daemon hands over, one line of JSON. Raises `ConfigurationError`."""
    from pcmrs.settings import Inherited

    try:
        return msgspec.json.decode(sys.stdin.buffer.readline(), type=Inherited)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ConfigurationError(f"Standard input is no configuration: {error}.") from None
