"""Reader of a journal: in order, filtered, and by command.

A journal that has grown continues in a new file: `ratms.sqlite` is followed by `ratms.sqlite.0002`. The first row of a
later file continues the hash chain and names the file before it. Earlier files are not written any more but must stay:
repeats of commands are found in them.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final, Literal, Self

from pcmrs.errors import JournalError
from pcmrs.journal.chain import COLUMNS, follow_files, stored_row
from pcmrs.journal.rows import JournalRow, Kind, StoredRow
from pcmrs.journal.schema import DATABASE_ERRORS, last_sequence, open_for_reading
from pcmrs.messages import Verdict

LARGEST: Final = 256e6
"""Default size beyond which a journal continues in a new file, bytes: about 200,000 rows."""


def numbered(journal: Path, number: int) -> Path:
    """Return the path of one file of a journal.

    Args:
        journal: First file.
        number: Number of the file, from 1.
    """
    return journal if number == 1 else journal.with_name(f"{journal.name}.{number:04d}")


def journal_files(journal: Path) -> list[Path]:
    """Return all files of a journal in order; `journal` itself is the first, and need not exist if it is the only one.

    Raises:
        JournalError: A file before the last one is missing.
    """
    later = {path for path in journal.parent.glob("*.[0-9][0-9][0-9][0-9]") if path.stem == journal.name}
    files = [numbered(journal, number) for number in range(1, len(later) + 2)]
    missing = [path for path in files[1:] if path not in later]
    if later and not journal.exists():
        missing.insert(0, journal)
    if missing:
        names = ", ".join(path.name for path in missing)
        text = f"{names} of the journal {journal} is missing, but later files exist: put it back from a copy."
        raise JournalError(text, path=str(missing[0]))
    return files


_File = tuple[Path, sqlite3.Connection]


class JournalReader:
    """Read-only view of a journal with all its files, also while a daemon writes it.

    Args:
        path: First file of the journal.

    Attributes:
        path: First file of the journal; a second reader of it may be used in another thread.

    Raises:
        JournalError: From the constructor: there is no such journal. From all methods: it cannot be read, or a row
            does not match its hash.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.open()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(
        self,
        *,
        after: int = 0,
        before: int | None = None,
        first: int | None = None,
        last: int | None = None,
        kind: Kind | None = None,
        branch: str | None = None,
        source: str | None = None,
        command_id: str | None = None,
    ) -> Iterator[StoredRow]:
        """Yield the rows that match all given filters, in order of their sequence.

        Args:
            after: Lower limit of the sequence, exclusive.
            before: Upper limit of the sequence, exclusive.
            first: Largest number of rows, counted from the start; with `last`, from the start of those.
            last: Largest number of rows, counted from the end.
            kind: Kind of the rows.
            branch: Branch of the rows.
            source: Source of the rows.
            command_id: Id of the command.
        """
        wanted = {"kind": kind, "branch": branch, "source": source, "command_id": command_id}
        filters = {column: value for column, value in wanted.items() if value is not None}
        bounds = {"sequence > ?": after} | ({} if before is None else {"sequence < ?": before})
        where = " AND ".join([*bounds, *(f"{column} = ?" for column in filters)])
        values = [*bounds.values(), *filters.values()]
        if last is not None:
            found = self._last(where, values, last)
        else:
            limit = -1 if first is None else first  # a negative limit is none
            query = f"SELECT {COLUMNS} FROM journal WHERE {where} ORDER BY sequence LIMIT ?"  # noqa: S608  # values are bound
            found = chain.from_iterable(self._rows(file, query, [*values, limit]) for file in self._followed())
        yield from islice(found, first)

    def verdict_of(self, source: str, command_id: str) -> Verdict | None:
        """Return the journalled verdict on a command, so that a repeat runs nothing; None if there is none.

        Args:
            source: Source of the command.
            command_id: Id of the command, unique for its source.
        """
        outcome = self.outcome_of(source, command_id)
        return None if outcome is None else outcome.verdict

    def outcome_of(self, source: str, command_id: str) -> JournalRow | None:
        """Return the row with the verdict on a command; None if there is none.

        Args:
            source: Source of the command.
            command_id: Id of the command, unique for its source.
        """
        return self._row_of("outcome", source, command_id)

    def intent_of(self, source: str, command_id: str) -> JournalRow | None:
        """Return the row that was written before a command started; None if there is none.

        Args:
            source: Source of the command.
            command_id: Id of the command, unique for its source.
        """
        return self._row_of("intent", source, command_id)

    def decided(self) -> Iterator[tuple[str, str]]:
        """Yield source and id of each command that has a verdict."""
        for path, connection in self._followed():
            try:
                yield from connection.execute("SELECT source, command_id FROM journal WHERE kind = 'outcome'")
            except DATABASE_ERRORS as error:
                raise JournalError(f"{path} cannot be read: {error}.", path=str(path)) from error

    def read_whole(self) -> Iterator[StoredRow]:
        """Yield all rows, and check that each is whole and follows from the one before.

        Raises:
            JournalError: A row is bad; the field ``sequence`` names the first one.
        """
        return follow_files(self._followed())

    def last_sequence(self) -> int:
        """Return the sequence of the last row; 0 if there is none."""
        path, newest = self._followed()[-1]
        return last_sequence(newest, path)

    def open(self) -> None:
        """Open the files; after `close`, as they are then."""
        self._files: list[_File] = []
        try:
            for path in journal_files(self.path):
                self._files.append((path, open_for_reading(path)))
        except JournalError:
            self.close()
            raise

    def close(self) -> None:
        """Close the files."""
        for _, connection in self._files:
            connection.close()

    def _followed(self) -> Sequence[_File]:
        """Return all files in order, including new ones in which the journal continues."""
        while (path := numbered(self.path, len(self._files) + 1)).exists():
            self._files.append((path, open_for_reading(path)))
        return self._files

    def _last(self, where: str, values: Sequence[Any], last: int) -> Iterator[StoredRow]:
        query = f"SELECT {COLUMNS} FROM journal WHERE {where} ORDER BY sequence DESC LIMIT ?"  # noqa: S608  # values are bound
        found: list[StoredRow] = []
        for file in reversed(self._followed()):
            if len(found) < last:
                found.extend(self._rows(file, query, [*values, last - len(found)]))
        return reversed(found)

    def _row_of(self, kind: Literal["intent", "outcome"], source: str, command_id: str) -> JournalRow | None:
        # The kind is part of the text since SQLite uses the index of that kind only then.
        query = f"SELECT {COLUMNS} FROM journal WHERE kind = '{kind}' AND source = ? AND command_id = ?"  # noqa: S608  # ours
        for file in reversed(self._followed()):
            for stored in self._rows(file, query, (source, command_id)):
                return stored.row
        return None

    def _rows(self, file: _File, query: str, values: Sequence[Any]) -> Iterator[StoredRow]:
        path, connection = file
        try:
            for record in connection.execute(query, values):
                yield stored_row(path, record)
        except DATABASE_ERRORS as error:
            raise JournalError(f"{path} cannot be read: {error}.", path=str(path)) from error
