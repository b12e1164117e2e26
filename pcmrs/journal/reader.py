"""Reading the journal: in order, filtered, and by command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

from pcmrs.errors import JournalError
from pcmrs.journal.chain import COLUMNS, follow_chain, stored_row
from pcmrs.journal.rows import Kind, StoredRow
from pcmrs.journal.schema import DATABASE_ERRORS, last_sequence, open_for_reading
from pcmrs.messages import Verdict


class JournalReader:
    """A read-only view of a journal file, also while a daemon writes it.

    Args:
        path: Of the file.

    Attributes:
        path: Of the file; a second reader of it may work in another thread.

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
        query, values = f"SELECT {COLUMNS} FROM journal WHERE {where}", [*bounds.values(), *filters.values()]
        if last is not None:
            query, values = f"SELECT * FROM ({query} ORDER BY sequence DESC LIMIT ?)", [*values, last]
        # A negative limit is none.
        values.append(-1 if first is None else first)
        yield from self._rows(f"{query} ORDER BY sequence LIMIT ?", values)

    def verdict_of(self, source: str, command_id: str) -> Verdict | None:
        """The recorded verdict on a command, so that a repeat runs nothing; None when there is none."""
        query = f"SELECT {COLUMNS} FROM journal WHERE kind = 'outcome' AND source = ? AND command_id = ?"
        for stored in self._rows(query, (source, command_id)):
            return stored.row.verdict
        return None

    def read_whole(self) -> Iterator[StoredRow]:
        """All rows, each only when it is whole and follows from the one before; a journal that is not ends in an error.

        Raises:
            JournalError: Its field ``sequence`` is the first row that is bad.
        """
        return follow_chain(self._connection, self.path)

    def last_sequence(self) -> int:
        """Sequence of the last row; 0 when there is none."""
        return last_sequence(self._connection, self.path)

    def open(self) -> None:
        """Opens the file again after `close`, as it is now."""
        self._connection = open_for_reading(self.path)

    def close(self) -> None:
        """Closes the file."""
        self._connection.close()

    def _rows(self, query: str, values: Sequence[Any]) -> Iterator[StoredRow]:
        try:
            for record in self._connection.execute(query, values):
                yield stored_row(self.path, record)
        except DATABASE_ERRORS as error:
            raise JournalError(f"{self.path} cannot be read: {error}.", path=str(self.path)) from error
