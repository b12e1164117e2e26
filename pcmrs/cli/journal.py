"""`pcmrs journal`: reads the journal of a cell, also while its daemon runs."""

from __future__ import annotations

import datetime
from pathlib import Path

import click
import msgspec

from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.running import readable_errors
from pcmrs.journal import JournalReader, StoredRow


@click.group()
def journal() -> None:
    """Look at what was asked, decided and reported."""


@journal.command()
@click.argument("path", type=click.Path(path_type=Path), required=False)
@click.option("--last", default=50, show_default=True, help="How many rows; 0 for all.")
@json_option
@config_options
@readable_errors
def show(path: Path | None, last: int, as_json: bool, file: Path | None, overrides: tuple[str, ...]) -> None:
    """Print the rows of the journal at PATH, or of the configured cell, oldest first."""
    with JournalReader(path or _of_cell(file, overrides)) as reader:
        for row in reader.read(last=last or None):
            click.echo(msgspec.json.encode(row).decode() if as_json else _line(row))


def _of_cell(file: Path | None, overrides: tuple[str, ...]) -> Path:
    from pcmrs.settings import read_settings
    from pcmrs.workflows import read_workflow

    settings = read_settings(file, overrides)
    return settings.cell.journal(read_workflow(settings.workflow).id)


def _line(stored: StoredRow) -> str:
    row = stored.row
    when = datetime.datetime.fromtimestamp(row.wall).isoformat(sep=" ", timespec="milliseconds")
    what = f"{row.branch}.{row.operation}" if row.branch else (row.operation or "")
    said = f"{stored.sequence:>6} {when} {row.kind:<8} {what} [{row.source}]"
    if row.verdict is not None:
        reason = f": {row.verdict.reason.text}" if row.verdict.reason is not None else ""
        return f"{said} {row.verdict.decision}{reason}"
    text = (row.result or {}).get("text", "")
    return f"{said} {text}".rstrip()
