"""Identities: a name that is never given twice, and the role that it has."""

from __future__ import annotations

import re

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.messages.roles import Role

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,62}")


class Identity(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One certificate.

    Attributes:
        name: The common name; it stands in the keys of the bus that belong to this identity.
        role: What it may do.
        serial: Of the certificate, hexadecimal.
        begins: Wall time from which it is valid, s.
        ends: Wall time until which it is valid, s.
        revoked: Wall time at which it was revoked, s; None when it was not.
    """

    name: str
    role: Role
    serial: str
    begins: float
    ends: float
    revoked: float | None = None

    def valid(self, now: float) -> bool:
        """Whether it counts at the wall time `now`, s."""
        return self.revoked is None and self.begins <= now < self.ends


def check_name(name: str) -> str:
    """Returns `name` if it may be an identity's: it has to stand between two slashes of a key.

    Raises:
        ConfigurationError: It is empty, longer than 63 characters, or holds others than ``a-z 0-9 . _ -``.
    """
    if not _NAME.fullmatch(name):
        text = (
            f"{name!r} cannot be a name: use 1 to 63 lower-case letters, digits, '.', '_' and '-', beginning with a "
            "letter or digit."
        )
        raise ConfigurationError(text, name=name)
    return name
