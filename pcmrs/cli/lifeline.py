"""Commands that the daemon starts: it sends them its configuration on standard input, and they end with that."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from pcmrs.errors import ConfigurationError

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the robot's kinematics.
    from pcmrs.settings import Inherited

T = TypeVar("T")

NICENESS = 10
"""Niceness of processes that serve neither robot nor procedure: control comes first."""


class _Plain(msgspec.Struct, frozen=True):
    """The daemon's line, decoded without loading anything else."""

    settings: dict[str, Any]


def inherited(line: bytes | None = None) -> Inherited:
    """Return the configuration from the daemon, one line of JSON; by default read from standard input.

    Args:
        line: The line; read from standard input if None.

    Raises:
        ConfigurationError: It is not such a line.
    """
    from pcmrs.settings import Inherited

    return _decoded(sys.stdin.buffer.readline() if line is None else line, Inherited)


def inherited_table(line: bytes) -> dict[str, Any]:
    """Return the configuration in the line as plain data, without loading anything else.

    Raises:
        ConfigurationError: It is not such a line.
    """
    return _decoded(line, _Plain).settings


def _decoded(line: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(line, type=kind)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ConfigurationError(f"Standard input is not a configuration: {error}.") from None
