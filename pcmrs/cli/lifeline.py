"""Commands that the daemon starts: it hands them its configuration on standard input, whose end is theirs."""

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
"""Of what serves neither robot nor procedure: control comes first."""


class _Plain(msgspec.Struct, frozen=True):
    """What the daemon hands over, as far as it can be had without loading anything."""

    settings: dict[str, Any]


def inherited(line: bytes | None = None) -> Inherited:
    """What the daemon hands over, one line of JSON; read from standard input if not given.

    Raises:
        ConfigurationError: It is no such line.
    """
    from pcmrs.settings import Inherited

    return _decoded(sys.stdin.buffer.readline() if line is None else line, Inherited)


def inherited_table(line: bytes) -> dict[str, Any]:
    """The configuration in it as plain data, for those who cannot wait. Raises `ConfigurationError`."""
    return _decoded(line, _Plain).settings


def _decoded(line: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(line, type=kind)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ConfigurationError(f"Standard input is no configuration: {error}.") from None
