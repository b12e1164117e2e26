"""Identities: a name that is never given twice, the role that it has, and the cells in which it has it.

Roles: what somebody on the bus may do, wherever that is decided.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Final, Literal, NamedTuple, get_args

import msgspec

from pcmrs.errors import ConfigurationError

Role = Literal["operator", "planner", "viewer", "device", "teleoperator", "daemon", "router"]

ROLES: tuple[Role, ...] = get_args(Role)
PEOPLE: tuple[Role, ...] = ("operator", "planner", "viewer", "teleoperator")
"""Roles of whoever sits at a console, or of the program that does it for them."""
COMMANDING: tuple[Role, ...] = ("operator", "planner", "teleoperator")
"""Roles that may ask for operations at all; a blueprint may say that some of them may not ask for one."""
HOLDING: tuple[Role, ...] = ("operator", "teleoperator")
"""Roles that may hold the lease of a cell."""
INFRASTRUCTURE: tuple[Role, ...] = ("daemon", "router")
"""Roles of processes that others dial."""


LOCAL: Final = "local"
"""Whoever comes over loopback on the cell's own machine; nobody else has this name."""
EVERY_CELL: Final = ("*/*",)

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,62}")
_PART = rf"(?:\*|{_NAME.pattern})"
_CELLS = re.compile(rf"{_PART}/{_PART}")


class Identity(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One certificate.

    Attributes:
        name: The common name; it stands in the keys of the bus that belong to this identity.
        role: What it may do.
        cells: Where it may do that: ``<site>/<cell>``, either may be ``*``.
        serial: Of the certificate, hexadecimal.
        begins: Wall time from which it is valid, s.
        ends: Wall time until which it is valid, s.
        revoked: Wall time at which it was revoked, s; None when it was not.
        via: Names of the routers that may carry what this person sends. Empty: none may.
    """

    name: str
    role: Role
    serial: str
    begins: float
    ends: float
    cells: tuple[str, ...] = EVERY_CELL
    revoked: float | None = None
    via: tuple[str, ...] = ()

    def valid(self, now: float) -> bool:
        """Whether it counts at the wall time `now`, s."""
        return self.revoked is None and self.begins <= now < self.ends

    def in_cell(self, cell: str) -> bool:
        """Whether `cell`, as ``<site>/<name>``, is one of its cells."""
        return any(fnmatchcase(cell, each) for each in self.cells)


class Principal(NamedTuple):
    """Somebody who asks for operations.

    Attributes:
        user: Name of the certificate, or of the peer that signs; `LOCAL` on the cell's own machine.
        role: What they may do.
    """

    user: str
    role: Role


ON_SITE: Final = Principal(LOCAL, "operator")
"""Whoever works on the cell's own machine."""


def check_name(name: str) -> str:
    """Returns `name` if it may be an identity's: it has to stand between two slashes of a key.

    Raises:
        ConfigurationError: It is empty, longer than 63 characters, holds others than ``a-z 0-9 . _ -``, or is `LOCAL`.
    """
    if not _NAME.fullmatch(name):
        text = (
            f"{name!r} cannot be a name: use 1 to 63 lower-case letters, digits, '.', '_' and '-', beginning with a "
            "letter or digit."
        )
        raise ConfigurationError(text, name=name)
    if name == LOCAL:
        text = f"{LOCAL!r} is the name of whoever works on the cell's own machine: choose another one."
        raise ConfigurationError(text, name=name)
    return name


def check_cells(cells: Iterable[str]) -> tuple[str, ...]:
    """Returns `cells` if each is ``<site>/<cell>``, of which either may be ``*``.

    Raises:
        ConfigurationError: One is something else, or there is none.
    """
    found = tuple(cells)
    for each in found or ("",):
        if not _CELLS.fullmatch(each):
            text = f"{each!r} is no cell: write its site and name, such as lab/cell1; either may be *."
            raise ConfigurationError(text, cell=each)
    return found


def shared_cells(ones: Iterable[str], others: Iterable[str]) -> tuple[str, ...]:
    """Return the cells that two identities have both; either may be written with ``*``."""
    found = []
    for one in ones:
        for other in others:
            pairs = list(zip(one.split("/"), other.split("/"), strict=True))
            if all(a == b or "*" in (a, b) for a, b in pairs):
                found.append("/".join(b if a == "*" else a for a, b in pairs))
    return tuple(dict.fromkeys(found))
