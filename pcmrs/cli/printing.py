"""What commands print. Text from outside can neither act on the terminal nor look like a line of PCMRS."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.console import Console, RenderableType
from rich.text import Text

from pcmrs.visible import visible

NARROWEST = 120
"""Columns of the tables: in a narrower terminal their lines wrap, so that no number is cut."""


class Terminal(Console):
    """Rich's console; of what it prints, only its own styles act on the terminal."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Called by Rich for every text that is printed or stands in a table."""
        return super().render_str(visible(text, keep="\n"), **options)


def say(text: str, *, err: bool = False) -> None:
    """Print one line, on standard error if `err`."""
    click.echo(visible(text), err=err)


def say_json(value: object) -> None:
    """Print a message, or anything else that `msgspec` can encode, as one line of JSON."""
    say(msgspec.json.encode(value).decode())


def print_report(report: msgspec.Struct, table: RenderableType, *, as_json: bool) -> None:
    """Print a report as JSON, or as the table that shows it."""
    if as_json:
        say_json(report)
    else:
        Terminal(width=max(Terminal().width, NARROWEST)).print(table)


def save_svg(table: RenderableType, path: Path) -> None:
    """Write a table as an SVG file. Raises `OSError` when that cannot be written."""
    console = Terminal(width=NARROWEST, record=True, file=io.StringIO())
    console.print(table)
    svg = console.export_svg(title="pcmrs")
    # Rich refers to a web font; a picture of a medical device's results loads nothing from anywhere.
    path.write_text(re.sub(r"@font-face\s*{[^}]*}", "", svg), encoding="utf-8")
