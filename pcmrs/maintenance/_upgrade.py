"""Upgrade of a cell's folder to the formats of this version: a copy is upgraded, then takes the place of the folder.

Nothing in the old folder changes. Until the names are exchanged, which is one step of the file system, the old version
can use it; afterwards the new one is complete. The old folder is the backup.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.failpoints import failpoint
from pcmrs.journal import verify
from pcmrs.journal.head import head_path
from pcmrs.journal.reader import LARGEST
from pcmrs.journal.schema import VERSION
from pcmrs.journal.verification import Progress
from pcmrs.journal.writer import JournalWriter
from pcmrs.maintenance._copying import check_room, copy_folder, exchange, make_new, settle, size_of, sync, unfinished
from pcmrs.maintenance._folder import JOURNALS, hold_folder, not_a_cell, write_format
from pcmrs.maintenance._formats import RECORDINGS, FileFormat, check_folder
from pcmrs.messages import Message

_UNFINISHED: Final = "unfinished-upgrade"
"""Name of a file in the copy: beside the folder, a folder with it is a copy, and one without it is the old folder."""


class UpgradeReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of an upgrade.

    Attributes:
        folder: Path of the folder.
        upgraded: Files that had an older format; empty if there was nothing to do.
        kept: Path of the old folder; None if there was nothing to do.
    """

    folder: str
    upgraded: tuple[FileFormat, ...]
    kept: str | None


def upgrade_folder(
    folder: Path, now: float, workflow: str | None = None, progress: Progress | None = None
) -> UpgradeReport:
    """Upgrade a folder, and keep the old one beside it. A second call after a crash continues or repeats it.

    Args:
        folder: Folder of a cell whose daemon does not run.
        now: Wall time, Unix seconds, for the name of the old folder.
        workflow: See `check_folder`.
        progress: Callback for the number of rows verified.

    Raises:
        ConfigurationError: It is not the folder of one cell, a daemon runs, a file is refused, there is too little
            space, or the file system cannot exchange names. The folder is unchanged.
        JournalError: A journal cannot be upgraded, or the upgraded one does not verify. The folder is unchanged.
        OSError: The disk refuses. The folder is unchanged.
    """
    kept = folder.with_name(f"{folder.name}.before-{datetime.fromtimestamp(now, UTC):%Y%m%dT%H%M%S}")
    # Before the lock, which makes a file and changes the mode of the folder.
    if other := not_a_cell(folder):
        raise _refused(folder, {str(folder): other})
    with hold_folder(folder):
        finished = _finish(folder, kept)
        found = check_folder(folder, workflow, progress)
        if found.refused:
            raise _refused(folder, {file.file: file.text for file in found.refused})
        if found.action == "use":
            return UpgradeReport(folder=str(folder), upgraded=(), kept=str(kept) if finished else None)
        copy = unfinished(folder)
        try:
            _make_upgraded(folder, copy, progress)
        except BaseException:
            shutil.rmtree(copy, ignore_errors=True)
            raise
        failpoint("upgrade.before_exchange")
        exchange(folder, copy)
        failpoint("upgrade.after_exchange")
        _finish(folder, kept)
        old = tuple(file for file in found.files if file.action == "upgrade")
        return UpgradeReport(folder=str(folder), upgraded=old, kept=str(kept))


def _make_upgraded(folder: Path, copy: Path, progress: Progress | None) -> None:
    """Make the copy, with all its files in the formats of this version."""
    check_room(copy, size_of(folder, frozenset({RECORDINGS})))
    make_new(copy)
    (copy / _UNFINISHED).touch()
    copy_folder(folder, copy, link=RECORDINGS, symbolic=True)
    failpoint("upgrade.after_copy")
    for journal in sorted(copy.glob(JOURNALS)):
        _adopt(journal)
        failpoint("upgrade.after_journal")
        _require_whole(journal, head_path(folder / journal.name), progress)
    write_format(copy)
    settle(copy)


def _adopt(journal: Path) -> None:
    """Open a journal for writing, which upgrades an older one in a transaction, with a row that reports it.

    Raises:
        JournalError: It cannot be written.
    """
    try:
        JournalWriter(journal, durable=True, largest=LARGEST).close()
    except JournalError as error:
        text = f"{journal.name} cannot be upgraded, and the old folder is unchanged: {error.text}"
        raise JournalError(text, **error.fields) from error


def _require_whole(journal: Path, old_head: Path, progress: Progress | None) -> None:
    """Require that the upgraded journal verifies, and still has the last row of the old one.

    Raises:
        JournalError: It does not, or has not.
    """
    found = verify(journal, kept=old_head if old_head.exists() else None, progress=progress)
    problems = found.problems or (() if found.version == VERSION else (f"It has format {found.version} still.",))
    if problems:
        text = f"The upgraded {journal.name} is not whole: {' '.join(problems)} The old folder is unchanged."
        raise JournalError(text, path=str(journal))


def _finish(folder: Path, kept: Path) -> bool:
    """End an upgrade that was interrupted after the exchange, and remove what an earlier interruption left.

    Returns:
        True if the old folder has got its name `kept` now.
    """
    beside = unfinished(folder)
    exchanged = beside.is_dir() and not (beside / _UNFINISHED).exists() and (folder / _UNFINISHED).exists()
    if exchanged:
        beside.rename(kept)
        sync(kept.parent)
        failpoint("upgrade.before_end")
    elif beside.is_dir() and (beside / _UNFINISHED).exists():
        shutil.rmtree(beside)
    (folder / _UNFINISHED).unlink(missing_ok=True)
    return exchanged


def _refused(folder: Path, reasons: Mapping[str, str]) -> ConfigurationError:
    listed = "\n".join(reasons.values())
    text = f"{folder} is not upgraded, and is unchanged:\n{listed}"
    return ConfigurationError(text, folder=str(folder), refused=list(reasons))
