"""`pcmrs journal replay`: checks that this program would make every recorded decision again."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import structlog
from rich.console import RenderableType
from rich.table import Table

from pcmrs.cli.journal import journal_of_cell, path_argument
from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.cli.tables import print_report

if TYPE_CHECKING:
    from pcmrs.replay import ReplayReport

LONG = 2000
"""Number of rows from which a replay takes long enough for a bar."""


@click.command()
@path_argument
@click.option(
    "--blueprint",
    type=click.Path(path_type=Path),
    help="Decide by this blueprint instead of that of the journal.",
)
@json_option
@config_options
@readable_errors
def replay(
    path: Path | None, blueprint: Path | None, as_json: bool, file: Path | None, overrides: tuple[str, ...]
) -> None:
    """Decide everything in the journal at PATH, or of the configured cell, again, and list the differences.

    PATH is a journal, or its export as JSON lines. Commands from outside and answers of devices are taken from it;
    checks of arguments, data and settings, states, locks, Stop and the latch are decided by this program.

    Exit status: 0 all the same, 1 something differs, 5 the journal cannot be replayed.
    """
    from pcmrs.clock import SystemClock
    from pcmrs.replay import replay as decide_anew

    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL)
    )  # problems of the recorded session
    with progress_bar(beyond=LONG, transient=True) as show:
        replayed = decide_anew(
            path or journal_of_cell(file, overrides),
            SystemClock(),
            blueprint,
            lambda done, total: show("deciding again", done, total),
        )
    print_report(replayed, _table(replayed), as_json=as_json)
    if not replayed.is_same:
        sys.exit(EXIT_REJECTED)


def _table(replayed: ReplayReport) -> RenderableType:
    result = "all as recorded" if replayed.is_same else f"{len(replayed.differences)} differences"
    summary = (
        f"{replayed.journal}: {replayed.rows} rows of {replayed.runs} runs, {replayed.compared} repeated, {result}; "
        f"{replayed.answered} commands needed recorded answers; {replayed.rows_per_second:.0f} rows/s"
    )
    if replayed.is_same:
        return summary
    table = Table("row", "what", "differs in", "recorded", "decided now", title=summary, title_justify="left")
    for each in replayed.differences:
        table.add_row(str(each.sequence), each.row, each.what, _shown(each.recorded), _shown(each.decided))
    return table


def _shown(value: Any) -> str:
    return "" if value is None else str(value)
