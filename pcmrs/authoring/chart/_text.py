"""Texts of a chart: cleaned for XML, measured without a font, wrapped and cut."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Sequence

from pcmrs.fsm.blueprint import BranchSpec

MONO = "'DejaVu Sans Mono', 'Liberation Mono', Menlo, Consolas, monospace"
SANS = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"

MONO_EM = 0.602
"""Advance of a glyph in em: the same in nearly all monospaced fonts, so that names are measured exactly."""

BOLD = 1.1
"""Width of bold text relative to regular text."""

_ILLEGAL = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_WIDE = frozenset("mwMW@%&—…")
_NARROW = frozenset("iljtfr.,:;'|!()[] ")


def clean(text: str) -> str:
    """Return the text on one line, with U+FFFD for characters that XML cannot hold."""
    return " ".join(_ILLEGAL.sub("\ufffd", text).split())


def mono_width(text: str, size: float) -> float:
    """Return the width of monospaced text in the unit of `size`.

    Args:
        text: The text.
        size: Font size.
    """
    return MONO_EM * size * sum(_columns(character) for character in text)


def sans_width(text: str, size: float) -> float:
    """Return the largest width of proportional text in the usual fonts, in the unit of `size`.

    Args:
        text: The text.
        size: Font size.
    """
    return size * sum(map(_sans_em, text))


def cut(text: str, columns: int) -> str:
    """Return the text, or as much of it as fits, with an ellipsis.

    Args:
        text: The text.
        columns: Width in characters.
    """
    return text if len(text) <= columns else text[: columns - 1] + "…"


def wrap(text: str, columns: int, lines: int) -> list[str]:
    """Return the text in lines; an ellipsis shows that more was there.

    Args:
        text: The text.
        columns: Width of a line in characters.
        lines: Largest number of lines.
    """
    return textwrap.wrap(text, columns, max_lines=lines, placeholder="…")


def flow(words: Sequence[str], columns: int) -> list[str]:
    """Return words in as many lines as they need; one longer than a line is broken at its spaces, then cut.

    Args:
        words: Pieces of text that should stay unbroken.
        columns: Width of a line in characters.
    """
    lines: list[str] = []
    pieces = (piece for word in words for piece in ([word] if len(word) <= columns else word.split()))
    for word in (cut(clean(piece), columns) for piece in pieces):
        if lines and len(lines[-1]) + 1 + len(word) <= columns:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def inner_lines(branch: BranchSpec, state: str) -> list[str]:
    """Return activity and timers of a state, as UML writes them: ``do / follow_head``, ``after 600 s / idle``.

    Args:
        branch: The branch.
        state: One of its states.
    """
    activity = branch.activities.get(state)
    timers = (f"{timer.when} / {timer.posts}" for timer in branch.timers_in(state).values())
    return [*([] if activity is None else [f"do / {activity.run}"]), *timers]


def widest(widths: Iterable[float]) -> float:
    """Return the largest value, or 0 if there is none."""
    return max(widths, default=0.0)


def _columns(character: str) -> int:
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1


def _sans_em(character: str) -> float:
    if _columns(character) == 2:
        return 1.0
    if character in _WIDE:
        return 0.95
    if character in _NARROW:
        return 0.36
    return 0.72 if character.isupper() else 0.6
