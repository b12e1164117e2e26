"""`pcmrs export-session`: one folder with all data that a cell has stored of a session."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say_json, say_lines
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the experiments.
    from pcmrs.report.session_export import ExportReport


@click.command("export-session")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder, new or empty."
)
@click.option("--session", metavar="ID", help="First characters of the session's id; by default the last session.")
@json_option
@config_options
@readable_errors
def export_session(
    output: Path, session: str | None, as_json: bool, file: Path | None, overrides: tuple[str, ...]
) -> None:
    """Copy a session of the configured cell into one folder, and verify the copy of its journal.

    The folder holds the journal with its signed head and public key, the recordings, the calibration files, the
    configuration and versions of the session, a README and the hashes of all files. The cell may be running.

    Exit status: 0 exported, 1 the journal is not sound (exported as it is), 5 it cannot be read or copied,
    4 the folder is in use, the disk too full, or the cell has journals of several other workflows than the configured
    one.

    Example: pcmrs export-session -o session1
    """
    from pcmrs.report.session_export import export_session as export
    from pcmrs.settings import read_settings
    from pcmrs.workflows import read_workflow

    settings = read_settings(file, overrides)
    journal = settings.cell.stored_journal(read_workflow(settings.workflow).id)
    with progress_bar(transient=True) as progress:
        exported = export(settings, journal, session, output, progress)
    if as_json:
        say_json(exported)
    else:
        say_lines(_lines(exported))
    if exported.problems:
        sys.exit(EXIT_REJECTED)


def _lines(exported: ExportReport) -> list[str]:
    return [
        f"session {exported.session} in {exported.folder}: {exported.rows} rows of the journal, "
        f"{len(exported.recordings)} recording files, {len(exported.calibrations)} calibration files",
        *(f"missing: {line}" for line in exported.missing),
        *(f"the journal is not sound: {line}" for line in exported.problems),
    ]
