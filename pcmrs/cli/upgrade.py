"""`pcmrs upgrade`: the folder of a cell in the formats of this version."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.cli.tables import print_report
from pcmrs.clock import SystemClock
from pcmrs.errors import PcmrsError

if TYPE_CHECKING:
    # For annotations only: asking for help must not load what reads journals.
    from collections.abc import Callable

    from pcmrs.journal.verification import Progress
    from pcmrs.maintenance import FolderCheck, UpgradeReport

LONG = 20_000
"""Number of rows from which it takes long enough for a bar."""
SENTENCES = {
    "use": "This version uses the folder as it is.",
    "upgrade": "`pcmrs upgrade` makes a copy in the new formats, which replaces the folder; the old one is kept.",
    "refuse": "This version refuses the folder, and changes nothing.",
}


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--check", is_flag=True, help="Only report what would happen.")
@click.option(
    "--config",
    "file",
    type=click.Path(path_type=Path),
    help="Configuration of the cell: it and the files that it names are checked, too.",
)
@json_option
@readable_errors
def upgrade(folder: Path, check: bool, file: Path | None, as_json: bool) -> None:
    """Bring FOLDER, a cell's folder that an earlier version wrote, to the formats of this version.

    The daemon must not run. A copy is upgraded and verified, then takes the place of FOLDER in one step; the old folder
    is kept as FOLDER.before-TIME. If it is interrupted, run it again: until that step, FOLDER is unchanged.

    Exit status: 0 done, or nothing to do; with --check, this version uses the folder now or after the upgrade; 1 with
    --check, it refuses the folder; 5 a journal or the disk failed; 4 it refuses the folder, or a daemon runs.

    Example: pcmrs upgrade --check ~/.local/state/pcmrs/lab-cell1
    """
    folder = folder.resolve()  # a name beside it is needed, which `.` and a link do not have
    with progress_bar(beyond=LONG, transient=True) as progress:
        if check:
            found = _check(folder, file, progress)
        else:
            report = _upgrade(folder, file, progress)
    if not check:
        _say(report, as_json=as_json)
        return
    print_report(found, _table(found), as_json=as_json)
    if found.action == "refuse":
        sys.exit(EXIT_REJECTED)


def _upgrade(folder: Path, file: Path | None, progress: Progress) -> UpgradeReport:
    from pcmrs.maintenance import upgrade_folder
    from pcmrs.settings import read_settings

    workflow = None if file is None else read_settings(file).workflow
    return upgrade_folder(folder, SystemClock().wall(), workflow, progress)


def _check(folder: Path, file: Path | None, progress: Progress) -> FolderCheck:
    from pcmrs.maintenance import FolderCheck, check_folder, check_named_files

    named, workflow = _configured(file)
    found = check_folder(folder, workflow, progress)
    return FolderCheck(folder=found.folder, files=(*found.files, *check_named_files(named)))


def _configured(file: Path | None) -> tuple[list[tuple[str, Path, Callable[[Path], object]]], str | None]:
    """Return the configuration and the files that it names, with their readers, and the configured workflow."""
    if file is None:
        return [], None
    from pcmrs.calibration import read_calibration
    from pcmrs.pki import read_register
    from pcmrs.settings import read_settings

    named: list[tuple[str, Path, Callable[[Path], object]]] = [("configuration", file, read_settings)]
    try:
        settings = read_settings(file)
    except PcmrsError:
        return named, None  # the check of the configuration says why
    calibration = settings.procedure.calibration
    for path in (calibration.tool_file, calibration.tip_file, calibration.pointer_file):
        if path:
            named.append(("calibration", Path(path), read_calibration))
    if settings.access.register:
        named.append(("register", Path(settings.access.register), read_register))
    return named, settings.workflow


def _say(report: UpgradeReport, *, as_json: bool) -> None:
    if as_json:
        say_json(report)
        return
    for file in report.upgraded:
        say(f"{file.kind}: format {file.format} to {file.newest}: {file.file}")
    if report.kept is None:
        say(f"{report.folder} has the formats of this version already: nothing was changed.")
    else:
        say(f"{report.folder} has the formats of this version now. The old folder is {report.kept}.")


def _table(found: FolderCheck) -> Group:
    table = Table(box=SIMPLE_HEAD)
    for name in ("kind", "format", "newest", "what happens"):
        table.add_column(name, no_wrap=True)
    table.add_column("file", overflow="fold")
    for file in found.files:
        table.add_row(file.kind, str(file.format or "not known"), str(file.newest), file.action, file.file)
    reasons = [line for file in found.files if file.text for line in file.text.splitlines()]
    return Group(table, *reasons, SENTENCES[found.action])
