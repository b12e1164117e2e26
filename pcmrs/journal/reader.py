"""Reading the journal: in order, filtered, and by command.

The files of one journal: the first, and those in which it goes on once that has grown.

`ratms.sqlite` is followed by `ratms.sqlite.0002`. The first row of a later file continues the chain of hashes and names
the file before it. An earlier file is not written any more, and stays where it is: repeats of commands are found in it.
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
"""Size beyond which a journal goes on in a new file unless told otherwise, bytes: some 200,000 rows."""


def numbered(journal: Path, number: int) -> Path:
    """The file of a journal with this number, from 1."""
    return journal if number == 1 else journal.with_name(f"{journal.name}.{number:04d}")


def journal_files(journal: Path) -> list[Path]:
    """All files of a journal in their order; the first, `journal` itself, need not be there when it is the only one.

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
        text = f"{names} of the journal {journal} is missing, and later files are there: put it back from a copy."
        raise JournalError(text, path=str(missing[0]))
    return files


_File = tuple[Path, sqlite3.Connection]


class JournalReader:
    """A read-only view of a journal with all its files, also while a daemon writes it.

    Args:
        path: Of the first file.

    Attributes:
        path: Of the first file; a second reader of it may work in another thread.

    Raises:
        JournalError: From the constructor: there is no such journal. From all methods: it cannot be read, or a row
            does not have the hash that was recorded with it.
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
        """Rows in order of their sequence, those that fit all filters given.

        Args:
            after: Only rows with a larger sequence.
            before: Only rows with a smaller one.
            first: At most so many: the first ones, of the `last` ones when both are given.
            last: At most so many: the last ones.
            kind: Only this kind.
            branch: Only of this branch.
            source: Only from this source.
            command_id: Only of this command.
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
        """The recorded verdict on a command, so that a repeat runs nothing; None when there is none."""
        outcome = self.outcome_of(source, command_id)
        return None if outcome is None else outcome.verdict

    def outcome_of(self, source: str, command_id: str) -> JournalRow | None:
        """The row with the verdict on a command; None when there is none."""
        return self._row_of("outcome", source, command_id)

    def intent_of(self, source: str, command_id: str) -> JournalRow | None:
        """The row that was written before a command began; None when there is none."""
        return self._row_of("intent", source, command_id)

    def decided(self) -> Iterator[tuple[str, str]]:
        """Source and id of every command that has a verdict."""
        for path, connection in self._followed():
            try:
                yield from connection.execute("SELECT source, command_id FROM journal WHERE kind = 'outcome'")
            except DATABASE_ERRORS as error:
                raise JournalError(f"{path} cannot be read: {error}.", path=str(path)) from error

    def read_whole(self) -> Iterator[StoredRow]:
        """All rows, each only when it is whole and follows from the one before; a journal that is not ends in an error.

        Raises:
            JournalError: Its field ``sequence`` is the first row that is bad.
        """
        return follow_files(self._followed())

    def last_sequence(self) -> int:
        """Sequence of the last row; 0 when there is none."""
        path, newest = self._followed()[-1]
        return last_sequence(newest, path)

    def open(self) -> None:
        """Opens the files again after `close`, as they are now."""
        self._files: list[_File] = []
        try:
            for path in journal_files(self.path):
                self._files.append((path, open_for_reading(path)))
        except JournalError:
            self.close()
            raise

    def close(self) -> None:
        """Closes the files."""
        for _, connection in self._files:
            connection.close()

    def _followed(self) -> Sequence[_File]:
        """All files in their order, with those in which the journal has gone on meanwhile."""
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
        # The kind is part of the text: only so does SQLite use the index of that kind.
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
