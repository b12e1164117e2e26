"""The register of all identities that have a certificate, or had one that was revoked."""

from __future__ import annotations

from pathlib import Path

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import Identity, check_name


def read_register(path: Path) -> list[Identity]:
    """Read the register of an authority, or a copy of it.

    Raises:
        ConfigurationError: The file cannot be read, or holds a name that is not allowed.
    """
    try:
        found = msgspec.json.decode(path.read_bytes(), type=list[Identity])
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigurationError(f"{path} cannot be read: {error}. Put it back from a copy.", path=str(path)) from None
    for each in found:
        check_name(each.name)
    return found
