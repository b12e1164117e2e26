"""Options and output that the fault commands share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import msgspec

from pcmrs.cli.printing import say_json
from pcmrs.cli.running import EXIT_REJECTED
from pcmrs.cli.tables import Terminal
from pcmrs.cli.values import POSITIVE
from pcmrs.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.table import Table

    from pcmrs_lab.campaign.catalogue import CatalogueRow

F = TypeVar("F", bound=Callable[..., Any])

seed_option = click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of everything random."
)


class OutputFolder(click.Path):
    """Folder that is created at once, so that minutes of work are not lost because it cannot be created."""

    def __init__(self) -> None:
        super().__init__(file_okay=False, writable=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or raise a usage error."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self.fail(f"{path} cannot be created: {error.strerror}.", param, ctx)
        return path


def output_option(what: str) -> Callable[[F], F]:
    """Return the option -o; the command gets it as `folder`. `what` is written there, for the help."""
    text = f"{what} to this folder, which is created if necessary."
    return click.option("-o", "--output", "folder", type=OutputFolder(), metavar="FOLDER", help=text)


minutes_option = click.option("--minutes", type=POSITIVE, help="Time limit, min.")


def print_findings(reports: Sequence[msgspec.Struct], violated: Sequence[bool], table: Table, *, as_json: bool) -> None:
    """Print the reports, and exit with status 1 if one of them has found a violation.

    Args:
        reports: Reports to print as JSON.
        violated: True for each report with a violation.
        table: Table to print otherwise.
        as_json: True to print JSON.
    """
    if as_json:
        found = [{**_fields(report), "violated": wrong} for report, wrong in zip(reports, violated, strict=True)]
        say_json({"simulated": True, "reports": found})
    else:
        Terminal().print(table)
    if any(violated):
        sys.exit(EXIT_REJECTED)


def _fields(report: msgspec.Struct) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.to_builtins(report)
    return fields


class PartOf(click.ParamType[tuple[int, int]]):
    """The k-th of n parts, written ``k/n``, as two numbers."""

    name = "k/n"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Return both numbers, or raise a usage error."""
        number, _, parts = str(value).partition("/")
        if not (number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts)):
            self.fail(f"{value!r} is not a part: write 2/3 for the second of three.", param, ctx)
        return int(number), int(parts)


def choosing(function: F) -> F:
    """Add --class and --id; the command gets them as `classes` and `ids`."""
    for option in (
        click.option("--id", "ids", multiple=True, metavar="ID", help="Only this fault, such as S3; may be repeated."),
        click.option(
            "--class",
            "classes",
            multiple=True,
            metavar="CLASS",
            help="Only operator, sensor, robot, network, process, storage, clock, adversary or order; may be repeated.",
        ),
    ):
        function = option(function)
    return function


def chosen(classes: Sequence[str], ids: Sequence[str]) -> list[CatalogueRow]:
    """Return the selected rows; raise a usage error if a class or fault is unknown.

    Args:
        classes: Values of --class.
        ids: Values of --id.
    """
    from pcmrs_lab.campaign.catalogue import choose

    try:
        return choose(classes, ids)
    except ConfigurationError as error:
        raise click.UsageError(error.text) from None
