"""Source of an archive: a journal, opened read-only, and read up to the row that its signed head names."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

from pcmrs.archive._segment import JournalName
from pcmrs.errors import ArchiveError, JournalError
from pcmrs.journal import JournalReader, JournalRow, Kind, journal_files
from pcmrs.journal.chain import REMEDY
from pcmrs.journal.head import head_path, parse_head
from pcmrs.journal.keys import PUBLIC, parse_public_key
from pcmrs.journal.rows import START, RowPosition, chain_hash, decode_row
from pcmrs.journal.schema import DATABASE_ERRORS, open_for_reading
from pcmrs.journal.soundness import require_rows, wrong_row


class ProvenRow(NamedTuple):
    """A row that the signature of the head proves.

    Attributes:
        sequence: Sequence of the row.
        row: The row.
        body: The row as canonical MessagePack, as it is in the journal.
        hash: Hash of the row, 32 bytes.
    """

    sequence: int
    row: JournalRow
    body: bytes
    hash: bytes


class JournalSource:
    """A journal with all its files; a daemon may still be writing the last one.

    Only the rows up to the one that the head names are read. Rows after it may be from a commit that was never
    acknowledged; the next run finds them under a later head.

    Args:
        path: First file of the journal. Its head and `journal.pub` are beside it.

    Attributes:
        path: First file of the journal.
        key: Public key, PEM.
        head: Bytes of the head file.
        end: Position of the row that the head names.

    Raises:
        JournalError: There is no such journal, it has no head or no key, or its head is not signed with that key.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.key, self.head = _read(path.parent / PUBLIC), _read(head_path(path))
        state = parse_head(self.head, parse_public_key(self.key, str(path.parent / PUBLIC)))
        if state.head is None:
            text = f"{head_path(path)} is damaged, or signed with another key than the one beside it. {REMEDY}"
            raise JournalError(text, path=str(path))
        self.end = state.head.place
        self._files: list[tuple[Path, sqlite3.Connection]] = []
        try:
            for file in journal_files(path):
                self._files.append((file, open_for_reading(file)))
        except JournalError:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for _, connection in self._files:
            connection.close()

    def name(self, cell: tuple[str, str] | None = None) -> JournalName:
        """Return the name of the journal in an archive; it must have a row.

        Args:
            cell: Site and name of its cell; None for those in the configuration that its daemon journalled.

        Raises:
            ArchiveError: The journal holds no configuration, or one of the names cannot be used.
            JournalError: A row cannot be read.
        """
        found = next(self._bodies(START.sequence, 1), None)
        if found is None:
            raise self._damage()
        sequence, body = found
        site, name = cell or self._configured_cell()
        return JournalName.of(site, name, decode_row(body).blueprint.id, chain_hash(START.hash, sequence, body))

    def has(self, place: RowPosition) -> bool:
        """Return whether the journal has a row at this position, up to the one that the head names."""
        if place == START:
            return True
        query = "SELECT hash FROM journal WHERE sequence = ? AND sequence <= ?"
        return next(self._select(query, (place.sequence, self.end.sequence)), None) == (place.hash,)

    def prove(self, after: RowPosition) -> None:
        """Prove the rows after a position: the chain through them must end in the hash that the head has signed.

        Only hashes are computed here, so that no row is archived before the last one is proven.

        Args:
            after: Position up to which the rows were proven before.

        Raises:
            JournalError: A row is missing or changed; the field ``sequence`` names it.
        """
        sequence, own = after.sequence, after.hash
        for sequence, body in self._bodies(after.sequence, self.end.sequence):
            own = chain_hash(own, sequence, body)
        if RowPosition(sequence, own) != self.end:
            raise self._damage()

    def read(self, after: RowPosition, most: int) -> Iterator[ProvenRow]:
        """Yield rows in order; they must have been proven.

        Args:
            after: Position after which they start.
            most: Largest number of rows.

        Raises:
            JournalError: A row cannot be read.
        """
        own = after.hash
        for sequence, body in self._bodies(after.sequence, min(after.sequence + most, self.end.sequence)):
            own = chain_hash(own, sequence, body)
            yield ProvenRow(sequence, decode_row(body), body, own)

    def _bodies(self, after: int, last: int, kind: Kind | None = None) -> Iterator[tuple[int, bytes]]:
        query = "SELECT sequence, body FROM journal WHERE sequence > ? AND sequence <= ?"
        if kind is None:
            return self._select(f"{query} ORDER BY sequence", (after, last))
        return self._select(f"{query} AND kind = ? ORDER BY sequence", (after, last, kind))

    def _select(self, query: str, values: tuple[object, ...]) -> Iterator[Any]:
        """Yield the rows that a query finds in each file."""
        for path, connection in self._files:
            try:
                yield from connection.execute(query, values)
            except DATABASE_ERRORS as error:
                raise JournalError(f"{path} cannot be read: {error}. {REMEDY}", path=str(path)) from error

    def _configured_cell(self) -> tuple[str, str]:
        for _, body in self._bodies(START.sequence, self.end.sequence, "config"):
            match decode_row(body).result:
                case {"settings": {"cell": {"site": str(site), "name": str(name)}}}:
                    return site, name
        text = f"{self.path} does not say of which cell it is: add it with --cell SITE/NAME."
        raise ArchiveError(text, path=str(self.path))

    def _damage(self) -> JournalError:
        """Return the error that names the first bad row, which takes a slower reading of all rows."""
        end = START
        try:
            with JournalReader(self.path) as reader:
                for stored in reader.read_whole():
                    end = RowPosition(stored.sequence, stored.hash)
                    if end == self.end:
                        break
            require_rows(self.path, self.end, end)
        except JournalError as error:
            return error
        return wrong_row(self.path, self.end)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        text = (
            f"{path} cannot be read: {error.strerror}. Only a journal with its signed head and public key is archived; "
            "a daemon of this version adds them at its next start."
        )
        raise JournalError(text, path=str(path)) from error
