"""The register of all identities that have a certificate, or had one that was revoked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import Identity, check_name


def read_register(path: Path) -> list[Identity]:
    """Read the register of an authority, or a copy of it.

    Raises:
        ConfigurationError: The file cannot be read, holds a name that is not allowed, or has an entry without cells.
    """
    try:
        entries = msgspec.json.decode(path.read_bytes(), type=list[dict[str, Any]])
        for entry in entries:
            _check_has_cells(path, entry)
        found = msgspec.convert(entries, list[Identity])
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigurationError(f"{path} cannot be read: {error}. Put it back from a copy.", path=str(path)) from None
    for each in found:
        check_name(each.name)
    return found


def _check_has_cells(path: Path, entry: Mapping[str, Any]) -> None:
    """Refuse an entry of an early version, whose certificate was valid in every cell.

    Raises:
        ConfigurationError: The entry of a name has no cells.
    """
    if "name" in entry and "cells" not in entry:
        name = entry["name"]
        text = (
            f"{path}: the entry of {name!r} names no cells. Add the cells in which it has its role to the authority's "
            'register, such as "cells": ["lab/cell1"], and copy that register to its routers and daemons.'
        )
        raise ConfigurationError(text, path=str(path), name=name)
