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
        ConfigurationError: The file cannot be read, a later version wrote it, it holds a name that is not allowed, or
            has an entry without cells.
    """
    try:
        content = path.read_bytes()
        _check_later(path, content)
        entries = msgspec.json.decode(content, type=list[dict[str, Any]])
        for entry in entries:
            _check_has_cells(path, entry)
        found = msgspec.convert(entries, list[Identity])
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigurationError(f"{path} cannot be read: {error}. Put it back from a copy.", path=str(path)) from None
    for each in found:
        check_name(each.name)
    return found


class _Later(msgspec.Struct):
    """A register of a later format, which is an object with its version; that of version 1 is a list."""

    schema: int


def _check_later(path: Path, content: bytes) -> None:
    try:
        later = msgspec.json.decode(content, type=_Later)
    except msgspec.DecodeError:
        return  # a list, or what the reader refuses
    raise ConfigurationError(
        f"{path} has format {later.schema}, and this version of PCMRS reads 1: use the version that wrote it, or a "
        "later one.",
        path=str(path),
        format=later.schema,
    )


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
