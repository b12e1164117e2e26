"""Clipping of what a sender chooses, before it is journalled, kept or published: a rejected command has no lease.

Without it, a user whose commands are all rejected would decide how much of the disk and memory each of them takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import Any, Final

import msgspec

from pcmrs.messages._decisions import Reason

LONGEST: Final = 4096
"""Limit of the arguments of a rejected command, bytes of their JSON; longer ones are clipped."""
LONGEST_FIELDS: Final = 2048
"""Limit of the fields of its reason, bytes of their JSON."""
LONGEST_TEXT: Final = 1000
"""Limit of the text of its reason, characters."""
BEGINNING: Final = 200
"""Length of the beginning that is kept of arguments and fields, bytes."""
CLIPPED: Final = "clipped"
"""Key in place of the arguments or fields."""


def clipped(arguments: Mapping[str, Any], longest: int = LONGEST) -> Mapping[str, Any]:
    """Return the arguments; if they are too long, their length, hash and beginning instead.

    Args:
        arguments: Arguments of a command, or fields of a reason.
        longest: Limit of their JSON, bytes.
    """
    whole = msgspec.json.encode(arguments, enc_hook=repr, order="sorted")
    if len(whole) <= longest:
        return arguments
    beginning = whole[:BEGINNING].decode(errors="replace")
    return {CLIPPED: {"bytes": len(whole), "sha256": sha256(whole).hexdigest(), "beginning": beginning}}


def clipped_reason(reason: Reason) -> Reason:
    """Return the reason of a rejection; its text and fields may repeat what the sender has chosen, and are clipped."""
    text, fields = shortened(reason.text, LONGEST_TEXT), clipped(reason.fields, LONGEST_FIELDS)
    if text is reason.text and fields is reason.fields:
        return reason
    return Reason(code=reason.code, text=text, fields=dict(fields))


def shortened(text: str, longest: int) -> str:
    """Return a text; if it is too long, its beginning and its length.

    Args:
        text: Text that may be of any length.
        longest: Limit of the text, or of the beginning that is kept, characters.
    """
    return text if len(text) <= longest else f"{text[:longest]}… ({len(text)} characters)"
