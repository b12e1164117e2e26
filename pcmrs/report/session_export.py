"""Export of a session: one folder with all its files, verified as they are copied."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.config import as_table
from pcmrs.errors import ConfigurationError
from pcmrs.journal import JournalReader, JournalRow, copy_journal, journal_files, verify
from pcmrs.journal.head import head_path
from pcmrs.messages import Message
from pcmrs.recording.series import session_files
from pcmrs.recording.settings import FOLDER
from pcmrs.report.session_folder import JOURNAL, make_folder, write_configuration, write_sums
from pcmrs.report.session_journal import configured_calibrations, find_session
from pcmrs.settings import Settings

__all__ = ["ExportReport", "export_session"]

Progress = Callable[[str, int, int], None]

VERIFICATION, VERSIONS, README = "verification.json", "versions.json", "README.txt"
CALIBRATION = "calibration"


class ExportReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of an export.

    Attributes:
        session: Id of the session.
        begun: Time of its first row, Unix seconds.
        rows: Number of whole, chained rows of the copied journal, which holds all sessions of its cell.
        problems: Problems of the copied journal; empty if it is sound.
        recordings: Names of the copied recording files.
        calibrations: Names of the copied calibration files.
        missing: Files and data that were not found, one line each.
    """

    folder: str
    session: str
    begun: float
    rows: int
    problems: tuple[str, ...]
    recordings: tuple[str, ...]
    calibrations: tuple[str, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Session:
    """A session in the journal.

    Attributes:
        row: Row of its start; its first row in a journal without such rows.
        settings: Settings of the session as plain data; None if the journal lacks them.
        versions: Versions of the programs; empty if the journal lacks them.
        calibration: Identity of the calibrations in use; empty if the journal lacks it.
    """

    row: JournalRow
    settings: Mapping[str, Any] | None
    versions: Mapping[str, Any]
    calibration: str


def export_session(
    settings: Settings, journal: Path, session: str | None, folder: Path, progress: Progress
) -> ExportReport:
    """Copy journal, recordings, calibrations and configuration of a session, and verify the copied journal.

    Args:
        settings: Present settings of the cell.
        journal: Journal of the cell; a daemon may be writing it.
        session: Start of the session's id; None for the last session.
        folder: Folder to be written. It must be new or empty.
        progress: Callback for the present step, the amount done, and the total.

    Raises:
        JournalError: The journal cannot be read, or has no such session.
        ConfigurationError: The folder is in use, or the disk is too full.
        OSError: A file cannot be copied.
    """
    found = _find(journal, session)
    configuration = found.settings if found.settings is not None else as_table(settings)
    recordings = session_files(settings.cell.path() / FOLDER, [found.row.session_id])
    calibrations, missing = _calibrations(configuration)
    if not recordings:
        missing.append(f"recordings of the session in {settings.cell.path() / FOLDER}")
    if found.settings is None:
        missing.append("the configuration of the session in the journal: the present one is here instead")
    _check_room(folder, [*journal_files(journal), *recordings, *calibrations.values()])
    make_folder(folder)
    copy_journal(journal, folder / JOURNAL)
    verification = verify(folder / JOURNAL, progress=progress)
    _write_json(folder / VERIFICATION, verification)
    write_configuration(configuration, folder)
    _write_json(folder / VERSIONS, {"session": found.versions, "export": _versions()})
    _copy_all({path.name: path for path in recordings}, folder / FOLDER, progress)
    _copy_all(calibrations, folder / CALIBRATION, progress)
    exported = ExportReport(
        folder=str(folder),
        session=found.row.session_id,
        begun=found.row.wall,
        rows=verification.rows,
        problems=verification.problems,
        recordings=tuple(path.name for path in recordings),
        calibrations=tuple(calibrations),
        missing=tuple(missing),
    )
    (folder / README).write_text(_readme(exported, found.calibration), encoding="utf-8")
    write_sums(folder)
    return exported


def _find(journal: Path, session: str | None) -> _Session:
    """Return the session whose id has this start. Raises `JournalError`."""
    with JournalReader(journal) as reader:
        starts = {stored.row.session_id: stored.row for stored in reader.read(kind="config")}
        if not starts:  # an older program has written it
            for stored in reader.read():
                starts.setdefault(stored.row.session_id, stored.row)
    rows = list(starts.values())
    row = rows[find_session(list(starts), session, journal)]
    result = (row.result or {}) if row.kind == "config" else {}
    return _Session(row, result.get("settings"), result.get("versions", {}), result.get("calibration", ""))


def _calibrations(configuration: Mapping[str, Any]) -> tuple[dict[str, Path], list[str]]:
    """Return the calibration files by their names in the export, and a line for each that is missing."""
    paths, missing = {}, []
    for kind, file in configured_calibrations(configuration).items():
        if Path(file).is_file():
            paths[f"{kind}.toml"] = Path(file)
        else:
            missing.append(f"the calibration file {file}")
    return paths, missing


def _check_room(folder: Path, sources: list[Path]) -> None:
    existing = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    needed, free = sum(path.stat().st_size for path in sources), shutil.disk_usage(existing).free
    if needed > free:
        text = f"{folder} needs {needed / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free: give a folder on another disk."
        raise ConfigurationError(text, needed=needed, free=free)


def _copy_all(sources: Mapping[str, Path], folder: Path, progress: Progress) -> None:
    if sources:
        folder.mkdir()
    for done, (name, path) in enumerate(sources.items()):
        progress(name, done, len(sources))
        shutil.copyfile(path, folder / name)


def _write_json(path: Path, content: Any) -> None:
    path.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")


def _versions() -> dict[str, str]:
    return {"pcmrs": version("pcmrs"), "python": platform.python_version()}


def _readme(exported: ExportReport, calibration: str) -> str:
    lost = "\n".join(f"- {line}" for line in exported.missing) or "- nothing"
    sound = "sound" if not exported.problems else f"NOT SOUND: {'; '.join(exported.problems)}"
    return f"""Session {exported.session} of a cell of PCMRS: research software, not a medical device.

{JOURNAL}: the cell's journal with all its sessions, {exported.rows} rows, {sound};
  {head_path(Path(JOURNAL))}: its signed head; journal.pub: the key that proves it.
  pcmrs journal verify {JOURNAL}; pcmrs journal show {JOURNAL}
{VERIFICATION}: result of that verification when this folder was made.
configuration.toml: the whole configuration of the session; pcmrs-serve --config reads it.
{VERSIONS}: of the programs, at the session and at this export.
{FOLDER}: messages of the bus (MCAP, for Foxglove, Rerun and pcmrs play). A file that was copied while it
  was written has no end: pcmrs repair.
{CALIBRATION}: the calibration files as they are now; the journal calls the calibration in use {calibration or "-"}.
SHA256SUMS: sha256sum --check SHA256SUMS

Missing:
{lost}
"""
