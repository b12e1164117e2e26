"""`pcmrs journal verify`: reads a whole journal and reports which part of it is sound."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs.cli.journal import journal_of_cell, path_argument
from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.cli.tables import print_report
from pcmrs.journal import JournalVerification
from pcmrs.journal import verify as verify_journal

LONG = 20_000
"""Number of rows from which it takes long enough for a bar."""

_file = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command()
@path_argument
@click.option("--public-key", "public", type=_file, help="Key that must have signed, if not journal.pub beside it.")
@click.option("--head", "kept", type=_file, help="An earlier copy of its head: reveals a journal that was rolled back.")
@json_option
@config_options
@readable_errors
def verify(
    path: Path | None,
    public: Path | None,
    kept: Path | None,
    as_json: bool,
    file: Path | None,
    overrides: tuple[str, ...],
) -> None:
    """Read the whole journal at PATH, or of the configured cell, and report which part of it is sound.

    Nothing is changed, and a daemon may be writing. The exit status is 0 for a journal that is whole, 1 for one that is
    damaged, 2 when there is none.
    """
    with progress_bar(beyond=LONG, transient=True) as progress:
        found = verify_journal(path or journal_of_cell(file, overrides), public=public, kept=kept, progress=progress)
    print_report(found, _table(found), as_json=as_json)
    if not found.sound:
        sys.exit(EXIT_REJECTED)


def _table(found: JournalVerification) -> Table:
    table = Table(title=found.journal, box=SIMPLE_HEAD, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("journal", "whole" if found.sound else "DAMAGED")
    table.add_row("rows", f"{found.rows} whole and in order from the first on")
    if found.first_bad is not None:
        table.add_row("first bad row", str(found.first_bad))
    table.add_row("signature", _signature(found))
    if found.head is not None:
        table.add_row("head", f"row {found.head[0]}, hash {found.head[1]}, written {found.head[2]} times")
        table.add_row("signed", f"{found.signed} rows are proven by it")
    if found.missing:
        table.add_row("missing", f"{found.missing} rows that the head names")
    if found.unnamed:
        table.add_row(
            "not in the head", f"{found.unnamed} rows after the last one that it names: left by a crash, or added"
        )
    if found.damaged_slots:
        table.add_row("slots of the head", f"{found.damaged_slots} of 2 damaged")
    for problem in found.problems:
        table.add_row("problem", problem)
    return table


def _signature(found: JournalVerification) -> str:
    if found.signature == "none":
        return f"none: version {found.version} has no head, so missing rows at the end cannot be detected"
    return found.signature
