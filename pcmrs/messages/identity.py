"""Identities and roles: an identity is a name that is never reused, its role, and its cells."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Final, Literal, NamedTuple, get_args

import msgspec

from pcmrs.errors import ConfigurationError

__all__ = ["Identity", "Principal", "Role"]

Role = Literal["operator", "planner", "viewer", "device", "teleoperator", "scene", "daemon", "router"]
"""Role of an identity. It decides which keys of the bus it may use, and which operations it may request."""

ROLES: tuple[Role, ...] = get_args(Role)
PEOPLE: tuple[Role, ...] = ("operator", "planner", "viewer", "teleoperator")
"""Roles of people, and of programs that act for them."""
COMMANDING: tuple[Role, ...] = ("operator", "planner", "teleoperator")
"""Roles that may send commands at all; a blueprint may restrict an operation to some of them."""
HOLDING: tuple[Role, ...] = ("operator", "teleoperator")
"""Roles that may hold the lease of a cell."""
INFRASTRUCTURE: tuple[Role, ...] = ("daemon", "router")
"""Roles of processes that others connect to."""

LOCAL: Final = "local"
"""Name of every user who connects over loopback on the cell's own machine; no identity has this name."""
EVERY_CELL: Final = ("*/*",)
"""Pattern of all cells."""

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,62}")
_PART = rf"(?:\*|{_NAME.pattern})"
_CELLS = re.compile(rf"{_PART}/{_PART}")


class Identity(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One certificate.

    Attributes:
        name: Common name of the certificate; part of the bus keys of this identity.
        role: Role of the identity.
        serial: Serial number of the certificate, hexadecimal.
        begins: Wall time from which it is valid, s.
        ends: Wall time until which it is valid, s.
        cells: Cells in which it has the role: ``<site>/<cell>``, either may be ``*``.
        revoked: Wall time at which it was revoked, s; None if it was not.
        via: Names of the routers that may carry the messages of this person; empty for none.
    """

    name: str
    role: Role
    serial: str
    begins: float
    ends: float
    cells: tuple[str, ...]
    revoked: float | None = None
    via: tuple[str, ...] = ()

    def valid(self, now: float) -> bool:
        """Return True if the identity is valid at the wall time `now`, s."""
        return self.revoked is None and self.begins <= now < self.ends

    def in_cell(self, cell: str) -> bool:
        """Return True if `cell`, as ``<site>/<name>``, is one of its cells."""
        return any(fnmatchcase(cell, each) for each in self.cells)


class Principal(NamedTuple):
    """User who sends commands.

    Attributes:
        user: Name in the certificate, or of the peer that signs; `LOCAL` on the cell's own machine.
        role: Role of the user.
    """

    user: str
    role: Role


ON_SITE: Final = Principal(LOCAL, "operator")
"""Every user on the cell's own machine."""


def check_name(name: str) -> str:
    """Return `name` if it can be the name of an identity, which is a chunk of bus keys.

    Raises:
        ConfigurationError: The name is empty, longer than 63 characters, has characters other than ``a-z 0-9 . _ -``,
            or is `LOCAL`.
    """
    if not _NAME.fullmatch(name):
        text = (
            f"{name!r} cannot be a name: use 1 to 63 lower-case letters, digits, '.', '_' and '-', beginning with a "
            "letter or digit."
        )
        raise ConfigurationError(text, name=name)
    if name == LOCAL:
        text = f"{LOCAL!r} is the name of all users on the cell's own machine: choose another one."
        raise ConfigurationError(text, name=name)
    return name


def check_cells(cells: Iterable[str]) -> tuple[str, ...]:
    """Return `cells` if each is ``<site>/<cell>``, where either may be ``*``.

    Raises:
        ConfigurationError: One has another form, or there is none.
    """
    found = tuple(cells)
    for each in found or ("",):
        if not _CELLS.fullmatch(each):
            text = f"{each!r} is not a cell: write its site and name, such as lab/cell1; either may be *."
            raise ConfigurationError(text, cell=each)
    return found


def shared_cells(ones: Iterable[str], others: Iterable[str]) -> tuple[str, ...]:
    """Return the cells that two identities have in common.

    Args:
        ones: Cells of the first identity, ``<site>/<cell>``; either part may be ``*``.
        others: Cells of the second identity, likewise.
    """
    found = []
    for one in ones:
        for other in others:
            pairs = list(zip(one.split("/"), other.split("/"), strict=True))
            if all(a == b or "*" in (a, b) for a, b in pairs):
                found.append("/".join(b if a == "*" else a for a, b in pairs))
    return tuple(dict.fromkeys(found))
