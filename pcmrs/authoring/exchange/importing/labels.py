"""The text on an arrow of a drawing: which events trigger it."""

from __future__ import annotations

import re

NO_EVENTS = "An arrow needs the events that trigger it, with commas between, without conditions and actions"
"""What to say where there are none."""

_REMARK = re.compile(r" \([^()]*\)$")


def events_of(label: str) -> list[str]:
    """The events a label names; empty where it names none, or holds a condition ``[…]`` or an action ``/ …``.

    A remark in round brackets at the end of an event is left out.
    """
    if any(sign in label for sign in "[]/"):
        return []
    parts = (_REMARK.sub("", " ".join(part.split())) for part in label.split(","))
    return list(dict.fromkeys(part for part in parts if part))
