"""Options and endings that the long fault commands share."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click
import msgspec

from pcmrs.cli.number import POSITIVE
from pcmrs.cli.running import EXIT_REJECTED

if TYPE_CHECKING:
    from rich.table import Table

seed_option = click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of all randomness."
)

minutes_option = click.option("--minutes", type=POSITIVE, help="End after so long, done or not.")


def print_findings(reports: Sequence[msgspec.Struct], violated: Sequence[bool], table: Table, *, as_json: bool) -> None:
    """Prints the reports, and exits with status 1 when one of them has found a violation."""
    if as_json:
        found = [{**_fields(report), "violated": wrong} for report, wrong in zip(reports, violated, strict=True)]
        click.echo(msgspec.json.encode({"simulated": True, "reports": found}).decode())
    else:
        from rich.console import Console

        Console().print(table)
    if any(violated):
        sys.exit(EXIT_REJECTED)


def _fields(report: msgspec.Struct) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.to_builtins(report)
    return fields
