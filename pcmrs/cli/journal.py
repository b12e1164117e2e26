"""`pcmrs journal`: reads the journal of a cell, also while its daemon runs."""

from __future__ import annotations

import datetime
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup
from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors, run
from pcmrs.clock import SystemClock
from pcmrs.journal import JournalReader, Kind, StoredRow

COMMANDS = {
    "show": LazyCommand("pcmrs.cli.journal:show"),
    "verify": LazyCommand(
        "pcmrs.cli.journal_verify:verify",
        "Read the whole journal at PATH, or of the configured cell, and report which part of it is sound.",
    ),
    "export": LazyCommand(
        "pcmrs.cli.journal_export:export",
        "Write the rows of the journal at PATH, or of the configured cell, into a file.",
    ),
    "replay": LazyCommand(
        "pcmrs.cli.journal_replay:replay",
        "Decide everything in the journal at PATH, or of the configured cell, again, and list the differences.",
    ),
}

FOLLOWING = 0.2
"""Period of --follow, s."""


@click.group(cls=LazyGroup, commands=COMMANDS)
def journal() -> None:
    """Print the recorded commands, decisions and reports, and prove that the journal is whole."""


path_argument = click.argument("path", type=click.Path(path_type=Path), required=False)


def filter_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add --kind, --branch, --source and --command; the command gets those given as `filters`."""

    @functools.wraps(function)
    def command(
        *, kind: Kind | None, branch: str | None, source: str | None, command_id: str | None, **given: Any
    ) -> Any:
        filters = {"kind": kind, "branch": branch, "source": source, "command_id": command_id}
        return function(filters=filters, **given)

    for option in (
        click.option("--command", "command_id", metavar="ID", help="Only rows of this command."),
        click.option("--source", help="Only rows from this source, such as bus:local."),
        click.option("--branch", help="Only rows of this branch."),
        click.option("--kind", type=click.Choice(get_args(Kind)), help="Only rows of this kind."),
    ):
        command = option(command)
    return command


@click.command()
@path_argument
@click.option("--last", default=50, show_default=True, help="How many rows; 0 for all.")
@click.option("--follow", is_flag=True, help="Continue with new rows, until interrupted.")
@filter_options
@json_option
@config_options
@readable_errors
def show(
    path: Path | None,
    last: int,
    follow: bool,
    filters: dict[str, Any],
    as_json: bool,
    file: Path | None,
    overrides: tuple[str, ...],
) -> None:
    """Print the rows of the journal at PATH, or of the configured cell, oldest first."""
    with JournalReader(path or journal_of_cell(file, overrides)) as reader:
        shown = 0
        for row in reader.read(last=last or None, **filters):
            if as_json:
                say_json(row)
            else:
                say(_line(row))
            shown = row.sequence
        if follow:
            run(_follow(reader, shown, filters, as_json=as_json))


async def _follow(reader: JournalReader, after: int, filters: dict[str, Any], *, as_json: bool) -> None:
    while True:
        await SystemClock().sleep(FOLLOWING)
        for row in reader.read(after=after, **filters):
            if as_json:
                say_json(row)
            else:
                say(_line(row))
            after = row.sequence


def journal_of_cell(file: Path | None, overrides: tuple[str, ...]) -> Path:
    """Return the journal of the configured cell.

    Args:
        file: Configuration file; None for the defaults.
        overrides: Values that override it, ``key=value``.

    Raises:
        ConfigurationError: The configuration is wrong, or the cell has journals of several other workflows.
        BlueprintError: Its workflow is not sound.
    """
    from pcmrs.settings import read_settings
    from pcmrs.workflows import read_workflow

    settings = read_settings(file, overrides)
    return settings.cell.stored_journal(read_workflow(settings.workflow).id)


def _line(stored: StoredRow) -> str:
    row = stored.row
    when = datetime.datetime.fromtimestamp(row.wall).isoformat(sep=" ", timespec="milliseconds")
    what = f"{row.branch}.{row.operation}" if row.branch else (row.operation or "")
    line = f"{stored.sequence:>6} {when} {row.kind:<8} {what} [{row.source}]"
    if row.verdict is not None:
        reason = f": {row.verdict.reason.text}" if row.verdict.reason is not None else ""
        return f"{line} {row.verdict.decision}{reason}"
    text = (row.result or {}).get("text", "")
    return f"{line} {text}".rstrip()
