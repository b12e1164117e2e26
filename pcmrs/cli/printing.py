"""Reports on standard output, and as pictures."""

from __future__ import annotations

import io
import re
from pathlib import Path

import click
import msgspec
from rich.console import Console, RenderableType

NARROWEST = 120
"""Columns of the tables: in a narrower terminal their lines wrap, so that no number is cut."""


def print_report(report: msgspec.Struct, table: RenderableType, *, as_json: bool) -> None:
    """Prints a report as JSON, or as the table that shows it."""
    if as_json:
        click.echo(msgspec.json.encode(report).decode())
    else:
        Console(width=max(Console().width, NARROWEST)).print(table)


def save_svg(table: RenderableType, path: Path) -> None:
    """Writes a table as an SVG file. Raises `OSError` when that cannot be written."""
    console = Console(width=NARROWEST, record=True, file=io.StringIO())
    console.print(table)
    svg = console.export_svg(title="pcmrs")
    # Rich refers to a web font; a picture of a medical device's results loads nothing from anywhere.
    path.write_text(re.sub(r"@font-face\s*{[^}]*}", "", svg), encoding="utf-8")
