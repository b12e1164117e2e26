"""Text of a table as a wide terminal shows it."""

from __future__ import annotations

import io

from rich.console import RenderableType

from pcmrs.cli.tables import Terminal


def shown(table: RenderableType) -> str:
    console = Terminal(width=250, file=io.StringIO(), record=True)
    console.print(table)
    return console.export_text()


def line_of(table: RenderableType, *words: str) -> list[str]:
    """Words of the one line that contains all of these words."""
    (line,) = [line for line in shown(table).splitlines() if all(word in line for word in words)]
    return line.split()
