"""`pcmrs backup` and `pcmrs restore`: a verified copy of a cell, and a cell from such a copy."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say_json, say_lines
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors
from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError

if TYPE_CHECKING:
    # For annotations only: asking for help must not load what reads journals.
    from pcmrs.maintenance import BackupReport, RestoreReport
    from pcmrs.settings import Settings

LONG = 20_000
"""Number of rows from which it takes long enough for a bar."""


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.option("--no-recordings", is_flag=True, help="Leave the recordings out, which are the largest files.")
@json_option
@config_options
@readable_errors
def backup(target: Path, no_recordings: bool, as_json: bool, file: Path | None, overrides: tuple[str, ...]) -> None:
    """Copy the configured cell into the new folder TARGET, and verify the copy. Its daemon may be running.

    The copy has the cell's folder with the key of its journal, and the files that the configuration names:
    calibrations, register, workflow, arm, tools of the tracker. It has no other key, and no token. It has patients'
    data: keep it as safe as the cell. Write down the line with the last row elsewhere: it shows later whether a journal
    was set back.

    Exit status: 0 copied, 5 a journal or the disk failed, 4 the target exists, or there is no such cell.

    Example: pcmrs backup /mnt/backup/cell1-monday --config /etc/pcmrs/cell.toml
    """
    from pcmrs.maintenance import back_up
    from pcmrs.settings import read_settings

    settings = read_settings(file, overrides)
    with progress_bar(beyond=LONG, transient=True) as progress:
        report = back_up(
            settings.cell.path(),
            target,
            SystemClock().wall(),
            configuration=_named_files(settings, file),
            recordings=not no_recordings,
            progress=progress,
        )
    if as_json:
        say_json(report)
    else:
        say_lines(_made(report))


@click.command()
@click.argument("backup", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.argument("folder", type=click.Path(path_type=Path))
@json_option
@readable_errors
def restore(backup: Path, folder: Path, as_json: bool) -> None:
    """Make a cell's folder FOLDER from BACKUP. FOLDER must be new or empty; it appears when it is complete.

    Each journal gets a row that says from which backup it was restored, and the next daemon starts latched: what the
    cell did after the backup is not known. Then set `cell.folder` to FOLDER, and start the daemon. Do not let two
    cells continue the same journal.

    Exit status: 0 restored, 5 the backup or the disk failed, 4 the folder is in use, or a later version is needed.

    Example: pcmrs restore /mnt/backup/cell1-monday ~/.local/state/pcmrs/lab-cell1
    """
    from pcmrs.maintenance import restore as restore_backup

    with progress_bar(beyond=LONG, transient=True) as progress:
        report = restore_backup(backup, folder.absolute(), progress)
    if as_json:
        say_json(report)
    else:
        say_lines(_restored(report))


def _named_files(settings: Settings, file: Path | None) -> dict[str, Path]:
    """Return the files that a configuration names and that are no secrets, by their names in the backup.

    Raises:
        ConfigurationError: Two files would have the same name.
    """
    calibration = settings.procedure.calibration
    named = [
        ("cell.toml", "" if file is None else str(file)),
        ("tool.toml", calibration.tool_file),
        ("tip.toml", calibration.tip_file),
        ("pointer.toml", calibration.pointer_file),
        ("register.json", settings.access.register),
        ("arm.urdf", settings.robot.model if settings.robot.model.endswith(".urdf") else ""),
    ]
    found: dict[str, Path] = {}
    for name, path in [
        *((name, Path(path)) for name, path in named if path),
        *((path.name, path) for path in (*_workflow_files(settings.workflow), *_tracker_files(settings))),
    ]:
        if found.setdefault(name, path) != path:
            text = f"{found[name]} and {path} would both be {name} in the backup: give one of them another name."
            raise ConfigurationError(text, file=str(path))
    return found


def _workflow_files(workflow: str) -> list[Path]:
    """Return the files of a workflow that is no installed one; its base and its approval are needed to start it."""
    from pcmrs.fsm.files.extend import extended_file
    from pcmrs.pki import approval_file
    from pcmrs.workflows.find import find_workflow

    if not workflow.endswith(".toml"):
        return []
    own = find_workflow(workflow)
    base = extended_file(own.blueprint)
    optional = (own.code, approval_file(own.blueprint))
    return [own.blueprint, *([] if base is None else [base]), *(path for path in optional if path.exists())]


def _tracker_files(settings: Settings) -> list[Path]:
    """Return the definitions of the tools, without which the tracker's node does not start."""
    tools: dict[str, str] = settings.ndi.get("tools", {}) if settings.tracker.driver == "ndi" else {}
    return [Path(path).expanduser().absolute() for path in tools.values()]


def _made(report: BackupReport) -> list[str]:
    manifest = report.manifest
    lines = [f"{report.backup}: {len(manifest.files)} files, {report.size / 1e6:.1f} MB, verified."]
    for name, journal in manifest.journals.items():
        lines.append(f"  {name}: {journal.rows} rows, last hash {journal.hash or 'not in the head'}")
    lines += [f"  not in the backup: {name}" for name in manifest.left_out]
    return [*lines, "It holds patients' data and the key of the journal: keep it as safe as the cell."]


def _restored(report: RestoreReport) -> list[str]:
    made = datetime.fromtimestamp(report.made, UTC).isoformat(timespec="seconds")
    lines = [f"{report.folder}: restored from the backup of {made}."]
    for name, rows in report.journals.items():
        lines.append(f"  {name}: {rows} rows, and one that reports the restoring; rows after the backup are not here")
    lines += [f"  not in the backup: {name}" for name in report.left_out]
    if report.configuration is not None:
        lines.append(f"  configuration and calibrations: {report.configuration}; put them where the daemon reads them")
    lines += [
        "  keys of people, peers and devices are not in a backup: put them back, or make new ones",
        'A peer with counter = "growing" could send commands from after the backup again: give it a new key.',
        "The daemon starts latched: check the cell, then acknowledge.",
    ]
    return lines
