"""Origin of every default of the configuration, from `origins.toml`."""

from __future__ import annotations

import re
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path

ORIGINS: list[dict[str, list[str] | str]] = tomllib.loads(Path(__file__).with_name("origins.toml").read_text())[
    "origins"
]
PATTERNS = [(pattern, str(group["text"])) for group in ORIGINS for pattern in group["keys"]]


def origin_of(table: str, key: str) -> str:
    """Return the origin of a default; empty if there is none.

    Args:
        table: Table of the key as the page names it, such as ``[procedure.zones.boxes]``.
        key: Key in that table.
    """
    return next((text for pattern, text in PATTERNS if fnmatchcase(full_name(table, key), pattern)), "")


def full_name(table: str, key: str) -> str:
    """Return the dotted name of a key, as patterns match it; see `origin_of` for the arguments."""
    return re.sub(r"[\[\]]", "", f"{table}.{key}".lstrip("."))
