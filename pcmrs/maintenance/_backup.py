"""Backup of a cell: a verified copy of its folder and of the files that its configuration names.

The key of the journal is part of it: without the key, a restored cell could not continue its journal. Keys of people,
peers and devices are not: their owners make new ones.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from pcmrs.errors import BackupError, ConfigurationError
from pcmrs.files import SECRET, sha256_of, write_durably
from pcmrs.journal import verify
from pcmrs.journal.keys import PRIVATE
from pcmrs.journal.verification import Progress
from pcmrs.maintenance._copying import (
    check_room,
    copy_folder,
    files_in,
    links_in,
    make_new,
    settle,
    size_of,
    sync,
    unfinished,
)
from pcmrs.maintenance._folder import JOURNALS, MANIFEST, later_format, not_a_cell
from pcmrs.maintenance._formats import RECORDINGS
from pcmrs.messages import Message

CONFIGURATION: Final = "configuration"
"""Folder of a backup with the files that the configuration names."""
SECRETS: Final = frozenset({"console.token", "device.key"})
"""Files of a cell's folder that are not in a backup: the daemon makes the first again, and `pcmrs pki` the second."""
SCHEMA: Final = 1
"""Version of the format of a backup."""
_LARGEST: Final = 64 * 1024 * 1024


class BackedUpJournal(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A journal in a backup.

    Attributes:
        rows: Sequence of its last row.
        hash: Hash of its last row, hexadecimal; empty if the head does not name that row, as after a crash.
    """

    rows: int
    hash: str


class Manifest(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Contents of a backup, in `MANIFEST`.

    Attributes:
        schema: Version of the format of the backup.
        program: Version of PCMRS that made it.
        made: Wall time, Unix seconds.
        folder: Path of the copied folder.
        journals: Journals by their names.
        files: SHA-256 of each file by its path in the backup, hexadecimal.
        left_out: Files that the backup does not hold, by name.
    """

    schema: int
    program: str
    made: float
    folder: str
    journals: dict[str, BackedUpJournal]
    files: dict[str, str]
    left_out: tuple[str, ...]


class BackupReport(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a backup.

    Attributes:
        backup: Path of the backup.
        size: Size of its files, bytes.
        manifest: Its contents.
    """

    backup: str
    size: int
    manifest: Manifest


def back_up(
    folder: Path,
    target: Path,
    now: float,
    *,
    configuration: Mapping[str, Path] | None = None,
    recordings: bool = True,
    progress: Progress | None = None,
) -> BackupReport:
    """Copy the folder of a cell, whose daemon may be running, and verify the copy.

    Args:
        folder: Folder of the cell.
        target: The backup, which must not exist; it appears when it is complete.
        now: Wall time, Unix seconds.
        configuration: Files that the configuration names, without secrets, by their names in the backup.
        recordings: False to leave the recordings out.
        progress: Callback for the number of rows verified.

    Raises:
        ConfigurationError: The target exists, there is no cell, a later version wrote it, the key of its journal is a
            symbolic link, or there is too little space.
        BackupError: A copied journal is not whole.
        JournalError: A journal cannot be read, or is written too fast to be copied.
        OSError: A file cannot be read or written.
    """
    configuration = configuration or {}
    leave_out = SECRETS | (frozenset() if recordings else {RECORDINGS})
    _check(folder, target)
    check_room(target, size_of(folder, leave_out))
    part = unfinished(target)
    make_new(part)
    try:
        copy_folder(folder, part, leave_out=leave_out)
        _copy_named(configuration, part / CONFIGURATION)
        journals = {path.name: _verified(path, progress) for path in sorted(part.glob(JOURNALS))}
        left_out = (*sorted(name for name in leave_out if (folder / name).exists()), *links_in(folder))
        manifest = Manifest(
            schema=SCHEMA,
            program=version("pcmrs"),
            made=now,
            folder=str(folder.absolute()),
            journals=journals,
            files=_hashes(part),
            left_out=left_out,
        )
        write_durably(part / MANIFEST, msgspec.json.format(msgspec.json.encode(manifest)) + b"\n", mode=SECRET)
        settle(part)
        part.rename(target)
        sync(target.absolute().parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return BackupReport(backup=str(target), size=size_of(target), manifest=manifest)


def read_backup(backup: Path) -> Manifest:
    """Read the manifest of a backup, and compare every file with it.

    Raises:
        BackupError: It is not a backup, a later version made it, or a file is missing, added or changed.
        OSError: A file cannot be read.
    """
    manifest = _read_manifest(backup)
    found = _hashes(backup)
    found.pop(MANIFEST, None)
    wrong = sorted(name for name in found.keys() | manifest.files.keys() if found.get(name) != manifest.files.get(name))
    if wrong:
        listed = ", ".join(wrong[:5]) + (f" and {len(wrong) - 5} more" if len(wrong) > 5 else "")
        text = f"{backup} was changed after it was made: {listed}. Use another backup."
        raise BackupError(text, path=str(backup), changed=wrong)
    return manifest


def _read_manifest(backup: Path) -> Manifest:
    path = backup / MANIFEST
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST)
        schema = msgspec.json.decode(content, type=_Schema).schema
        if schema == SCHEMA:
            return msgspec.json.decode(content, type=Manifest)
    except FileNotFoundError:
        text = f"{backup} is not a backup: it has no {MANIFEST}. `pcmrs backup` makes one."
        raise BackupError(text, path=str(backup)) from None
    except msgspec.DecodeError as error:
        raise BackupError(f"{path} is damaged: {error}. Use another backup.", path=str(path)) from None
    text = f"{backup} has format {schema}, and this version of PCMRS reads {SCHEMA}: restore it with a later version."
    raise BackupError(text, path=str(backup), format=schema, limit=SCHEMA)


class _Schema(msgspec.Struct):
    schema: int


def _check(folder: Path, target: Path) -> None:
    if not folder.is_dir():
        raise ConfigurationError(f"There is no cell in {folder}: give its --config.", folder=str(folder))
    if (folder / MANIFEST).exists():
        text = f"{folder} is a backup itself: copy it as it is."
        raise ConfigurationError(text, folder=str(folder))
    if other := not_a_cell(folder):
        raise ConfigurationError(other, folder=str(folder))
    if later := later_format(folder):
        raise ConfigurationError(later, folder=str(folder))
    if (key := folder / PRIVATE).is_symlink():
        text = (
            f"{key} is a symbolic link to {key.readlink()}, and a backup does not follow links: without the key it "
            "could not be restored. Put the key itself there, and repeat."
        )
        raise ConfigurationError(text, file=str(key))
    if target.exists():
        raise ConfigurationError(f"{target} exists already: give another name.", file=str(target))
    if target.resolve().is_relative_to(folder.resolve()):
        text = f"{target} is in the folder that it would be a copy of: give a place outside, best on another disk."
        raise ConfigurationError(text, file=str(target))


def _copy_named(configuration: Mapping[str, Path], folder: Path) -> None:
    if configuration:
        folder.mkdir(mode=0o700)
    for name, path in configuration.items():
        shutil.copy2(path, folder / name)


def _verified(journal: Path, progress: Progress | None) -> BackedUpJournal:
    found = verify(journal, progress=progress)
    if found.problems:
        text = (
            f"The copy of {journal.name} is not whole: {' '.join(found.problems)} There is no backup. Check the disk, "
        )
        raise BackupError(f"{text}then `pcmrs journal verify`.", path=str(journal))
    head = ("" if found.head is None else found.head[1]) if not found.unnamed else ""
    return BackedUpJournal(rows=found.rows, hash=head)


def _hashes(folder: Path) -> dict[str, str]:
    return {path.relative_to(folder).as_posix(): sha256_of(path).hex() for path in files_in(folder)}
