"""Tables that commands print; separate from lines, because daemon and nodes do not need Rich."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console, RenderableType
from rich.text import Text

from pcmrs.cli.printing import say_json
from pcmrs.visible import visible

NARROWEST = 120
"""Smallest width of a table, in columns: a narrower terminal wraps its lines, so that no number is cut."""


class Terminal(Console):
    """Rich's console, on which no text has an effect: brackets are no markup, and each string is one line.

    Use `styled` for a style, and for several lines.

    Args:
        options: Options of Rich's console.
    """

    def __init__(self, **options: Any) -> None:
        # A command's id such as `[/x]` raises an error as markup, and `[link=…]` makes escape sequences.
        super().__init__(markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text for a table or a line; Rich calls this for every string."""
        return super().render_str(visible(text), **options)


def styled(*lines: str, style: str = "") -> Text:
    """Return lines in a style, for a table or a `Terminal`, which does not escape a `Text`.

    Args:
        lines: The lines.
        style: A style of Rich, such as ``bold red``.
    """
    return Text("\n".join(map(visible, lines)), style)


def print_report(report: msgspec.Struct, table: RenderableType, *, as_json: bool) -> None:
    """Print a report as JSON or as a table.

    Args:
        report: The report.
        table: Its table.
        as_json: Print JSON.
    """
    if as_json:
        say_json(report)
    else:
        print_table(table)


def print_table(table: RenderableType) -> None:
    """Print a table, at least `NARROWEST` wide."""
    Terminal(width=max(Terminal().width, NARROWEST)).print(table)


def save_svg(table: RenderableType, path: Path) -> None:
    """Write a table as an SVG file.

    Args:
        table: The table.
        path: File to write.

    Raises:
        OSError: It cannot be written.
    """
    console = Terminal(width=NARROWEST, record=True, file=io.StringIO())
    console.print(table)
    svg = console.export_svg(title="pcmrs")
    # Rich refers to a web font; a picture of a medical device's results must not load anything.
    path.write_text(re.sub(r"@font-face\s*{[^}]*}", "", svg), encoding="utf-8")
