"""Arguments of rejected commands as the journal keeps them: short ones whole, of long ones their hash and beginning."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import Any, Final

import msgspec

LONGEST: Final = 4096
"""Arguments of a rejected command that are longer, bytes of their JSON, are clipped."""
BEGINNING: Final = 200
"""So much of them is kept, bytes."""
CLIPPED: Final = "clipped"
"""Stands in place of the arguments."""


def clipped(arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    """The arguments, or what is kept of them where they are too long: their length, hash and beginning."""
    whole = msgspec.json.encode(arguments, enc_hook=repr, order="sorted")
    if len(whole) <= LONGEST:
        return arguments
    beginning = whole[:BEGINNING].decode(errors="replace")
    return {CLIPPED: {"bytes": len(whole), "sha256": sha256(whole).hexdigest(), "beginning": beginning}}
