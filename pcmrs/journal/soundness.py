"""Check before a journal is written: it must hold every row that its head names, or its end was lost."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from pcmrs.errors import JournalError
from pcmrs.journal.chain import REMEDY, first_without_mac, follow_files, mac_key, starts_of
from pcmrs.journal.head import Head, HeadState, head_path, read_head
from pcmrs.journal.keys import signing_key
from pcmrs.journal.reader import journal_files
from pcmrs.journal.rows import START, RowPosition, StoredRow
from pcmrs.journal.schema import HEADLESS, WITHOUT_MAC, check_schema, last_sequence, open_for_reading, version_of

LARGEST_GROUP: Final = 512
"""Largest number of rows of one commit, and so of rows that a crash can leave unnamed by the head."""


@dataclass(frozen=True, slots=True)
class WritableJournal:
    """A journal that may be written.

    Attributes:
        file: File to be written.
        key: Private key that signs the head.
        version: Version of the file; 0 if there is none yet.
        head: Present head; None if it must be created.
        last: Last row; None if there are no rows.
        damaged: Number of damaged slots of the head.
    """

    file: Path
    key: Ed25519PrivateKey
    version: int
    head: Head | None
    last: StoredRow | None
    damaged: int

    @property
    def place(self) -> RowPosition:
        """Position of the last row."""
        return START if self.last is None else RowPosition(self.last.sequence, self.last.hash)

    @property
    def unnamed(self) -> int:
        """Number of rows after the head: they were committed when the writer died, and never acknowledged."""
        return 0 if self.head is None else self.place.sequence - self.head.place.sequence


def examine(path: Path) -> WritableJournal:
    """Read the journal from its last snapshot on, and the head, without writing to either.

    Without a snapshot in the newest file, the chain is followed from the end of the file before it, or from the first
    row; so is that of a journal of version 1, which has no head.

    Raises:
        JournalError: Rows are missing, changed, or were added without the key; the head or its key is missing
            or damaged; the file is not a journal.
    """
    files = journal_files(path)
    newest = files[-1]
    version = 0 if files == [path] and (not path.exists() or path.stat().st_size == 0) else _version(newest)
    headed = head_path(path).exists()
    key = signing_key(path.parent, make=not headed and version in (0, HEADLESS))
    state = read_head(head_path(path), key.public_key())
    head = require_head(path, state, version)
    last, without_mac = None, None
    if version:
        last, without_mac = _read_end(files, version, head, mac_key(key))
    found = WritableJournal(newest, key, version, head, last, 0 if state is None else state.damaged)
    if head is not None:
        require_rows(path, head.place, found.place)
        require_named(path, found.unnamed, found.damaged)
        _require_macs(path, without_mac, version)
    return found


def require_head(path: Path, state: HeadState | None, version: int) -> Head | None:
    """Return the head that a journal must have; None if it must be created.

    Args:
        path: First file of the journal.
        state: Content of the head file; None if there is no such file.
        version: Version of the journal; 0 if there is none yet.

    Raises:
        JournalError: The head is missing or damaged.
    """
    where = head_path(path)
    if state is None:
        if version <= HEADLESS:
            return None
        text = f"{where} is missing, so it is unknown whether rows at the end of {path} are missing, too. {REMEDY}"
        raise JournalError(text, path=str(where))
    if state.head is None:
        text = f"{where} is damaged, or signed with another key than the one beside it. {REMEDY}"
        raise JournalError(text, path=str(where))
    return state.head


def require_rows(path: Path, named: RowPosition, last: RowPosition) -> None:
    """Require that the journal holds the row that the head names.

    Args:
        path: First file of the journal.
        named: Position that the head names.
        last: Position of the last row.

    Raises:
        JournalError: Rows are missing; the field ``missing`` is their number.
    """
    missing = named.sequence - last.sequence
    if missing > 0:
        raise JournalError(
            f"{path} ends with row {last.sequence}, and its signed head names row {named.sequence}: {missing} "
            f"acknowledged rows are lost. {REMEDY}",
            path=str(path),
            missing=missing,
            last=last.sequence,
        )


def wrong_row(path: Path, named: RowPosition) -> JournalError:
    """Return the error for a row that is not the one that the head names.

    Args:
        path: First file of the journal.
        named: Position that the head names.
    """
    text = f"{path} holds another row {named.sequence} than the one that its signed head names. {REMEDY}"
    return JournalError(text, path=str(path), sequence=named.sequence)


def require_named(path: Path, unnamed: int, damaged: int) -> None:
    """Require that no more rows follow the head than a crash can leave: one group, or two if a slot was torn.

    Args:
        path: First file of the journal.
        unnamed: Number of rows after the head.
        damaged: Number of damaged slots.

    Raises:
        JournalError: There are more; the field ``unnamed`` is their number.
    """
    if unnamed > LARGEST_GROUP * (1 + damaged):
        raise JournalError(
            f"{path} has {unnamed} rows after the last one that its signed head names, and a crash leaves no more "
            f"than {LARGEST_GROUP}: another program wrote them, or the head is outdated. {REMEDY}",
            path=str(path),
            unnamed=unnamed,
        )


def _require_macs(path: Path, without_mac: int | None, version: int) -> None:
    """Require the MAC of each row after the head: the next head would sign the row, no matter who wrote it.

    Raises:
        JournalError: A row has no valid MAC; the field ``sequence`` names the first one.
    """
    if without_mac is None:
        return
    why = "It was written without the key."
    if version <= WITHOUT_MAC:
        why = (
            f"Rows of version {version} have none, so it is unknown whether a crash left it there or someone added it. "
            "If the daemon has crashed, start the version of PCMRS before this one once, which adopts the row, and "
            "stop it in order."
        )
    raise JournalError(
        f"{path}: row {without_mac} follows the last one that its signed head names, and does not have the MAC of "
        f"journal.key. {why} Do not trust the rows from {without_mac} on: `pcmrs journal show` prints them. Keep the "
        "files unchanged and continue in another cell.folder.",
        path=str(path),
        sequence=without_mac,
    )


def _version(path: Path) -> int:
    with closing(open_for_reading(path)) as connection:
        return version_of(connection)


def _read_end(
    files: Sequence[Path], version: int, head: Head | None, key: bytes
) -> tuple[StoredRow | None, int | None]:
    """Return the last row, and the sequence of the first row after the head without a valid MAC."""
    last = without_mac = None
    with ExitStack() as stack:
        opened = [(path, stack.enter_context(closing(open_for_reading(path)))) for path in files]
        for _, connection in opened:
            connection.execute("BEGIN")  # one view of rows and MACs
        path, newest = opened[-1]
        check_schema(newest, path)
        snapshot = last_sequence(newest, path, kind="snapshot")
        if version == HEADLESS and (snapshot or last_sequence(newest, path, kind="config")):
            text = f"{path} has version {version}, but holds rows of a later one. {REMEDY}"
            raise JournalError(text, path=str(path))
        starts = starts_of(opened)
        first = min(snapshot or starts[-1].sequence + 1, head.place.sequence if head is not None else 0)
        number = max(number for number, start in enumerate(starts) if start.sequence < max(first, 1))
        after = first - 1 if first - 1 > starts[number].sequence else starts[number]
        for last in follow_files(opened[number:], after):
            if head is not None and last.sequence == head.place.sequence and last.hash != head.place.hash:
                raise wrong_row(path, head.place)
        if head is not None:
            without_mac = first_without_mac(opened, head.place.sequence, key)
    return last, without_mac
