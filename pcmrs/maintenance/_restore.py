"""Restoring of a backup into an empty folder. Each restored journal says that it was set back.

A copy of key, head and rows that is put back looks like a journal that nothing happened to. Therefore the first row
after the restoring names the backup, and a daemon starts latched: what the cell did after the backup is unknown.
"""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from pcmrs.errors import BackupError, ConfigurationError
from pcmrs.journal import JournalReader, verify
from pcmrs.journal.notes import restored_row
from pcmrs.journal.reader import LARGEST
from pcmrs.journal.rows import encode_row
from pcmrs.journal.verification import Progress
from pcmrs.journal.writer import JournalWriter
from pcmrs.maintenance._backup import CONFIGURATION, Manifest, read_backup
from pcmrs.maintenance._copying import check_room, files_in, make_new, settle, size_of, sync, unfinished
from pcmrs.maintenance._folder import JOURNALS, MANIFEST, later_format, write_format
from pcmrs.messages import Message

_NOT_COPIED: Final = frozenset({CONFIGURATION, MANIFEST})


class RestoreReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a restoring.

    Attributes:
        folder: Path of the restored folder.
        made: Time of the backup, Unix seconds.
        journals: Number of rows of each journal in the backup, by its name.
        configuration: Path of the backup's copies of the files that the configuration names; None if it has none.
        left_out: Files that the backup did not hold.
    """

    folder: str
    made: float
    journals: dict[str, int]
    configuration: str | None
    left_out: tuple[str, ...]


def restore(backup: Path, folder: Path, progress: Progress | None = None) -> RestoreReport:
    """Restore a backup into a folder, which appears when it is complete.

    Args:
        backup: The backup; it is not changed.
        folder: Folder that does not exist or is empty.
        progress: Callback for the number of rows verified.

    Raises:
        ConfigurationError: The folder is in use, a later version wrote the copied folder, or there is too little space.
        BackupError: The backup is damaged, or of a later version.
        JournalError: A journal cannot be continued.
        OSError: A file cannot be read or written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        text = f"{folder} is not empty, and nothing in it is replaced: give another folder, or move this one away."
        raise ConfigurationError(text, folder=str(folder))
    if folder.resolve().is_relative_to(backup.resolve()):
        text = f"{folder} is in the backup, which would be changed by that: give a place outside."
        raise ConfigurationError(text, folder=str(folder))
    manifest = read_backup(backup)
    if later := later_format(backup):
        raise ConfigurationError(later, folder=str(backup))
    check_room(folder, size_of(backup, _NOT_COPIED))
    part = unfinished(folder)
    make_new(part)
    try:
        _copy(backup, part)
        for journal in sorted(part.glob(JOURNALS)):
            _continue_journal(journal, manifest, progress)
        write_format(part)
        settle(part)
        part.rename(folder)  # replaces an empty folder
        sync(folder.absolute().parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    configuration = backup / CONFIGURATION
    return RestoreReport(
        folder=str(folder),
        made=manifest.made,
        journals={name: journal.rows for name, journal in manifest.journals.items()},
        configuration=str(configuration) if configuration.is_dir() else None,
        left_out=manifest.left_out,
    )


def _copy(backup: Path, part: Path) -> None:
    for path in files_in(backup):
        name = path.relative_to(backup)
        if name.parts[0] not in _NOT_COPIED:
            (part / name).parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            shutil.copy2(path, part / name)


def _continue_journal(journal: Path, manifest: Manifest, progress: Progress | None) -> None:
    """Append the row that reports the restoring, and verify the journal with it.

    Raises:
        BackupError: The journal is not whole.
        JournalError: It cannot be continued.
    """
    with JournalReader(journal) as reader:
        last = next((stored.row for stored in reader.read(last=1)), None)
    writer = JournalWriter(journal, durable=True, largest=LARGEST)
    try:
        if last is not None:
            row = restored_row(last, _time(manifest.made), manifest.program, manifest.journals[journal.name].rows)
            writer.write([(row, encode_row(row))])
    finally:
        writer.close()
    found = verify(journal, progress=progress)
    if found.problems:
        text = f"The restored {journal.name} is not whole: {' '.join(found.problems)} Nothing was restored."
        raise BackupError(text, path=str(journal))


def _time(wall: float) -> str:
    return datetime.fromtimestamp(wall, UTC).isoformat(timespec="seconds")
