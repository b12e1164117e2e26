"""Interface of the places that hold an archive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import pyarrow as pa

from pcmrs.archive._segment import JournalName, Segment

Progress = Callable[[str, int, int], None]
"""Callback for the present journal, how much is done, and the total."""


@dataclass(frozen=True, slots=True)
class ArchivedJournal:
    """A journal in an archive.

    Attributes:
        name: Name of the journal.
        key: Public key of its cell, PEM.
        head: Head file under which its last rows were archived; empty if the first run has not ended.
    """

    name: JournalName
    key: bytes
    head: bytes


class ArchiveStore(Protocol):
    """Segments of journals, and a catalogue of them.

    All methods raise `ArchiveError` if the place cannot be used.
    """

    def journals(self) -> list[ArchivedJournal]:
        """Return the journals in the order of their names."""

    def segments(self, journal: JournalName) -> list[Segment]:
        """Return the segments of a journal that the catalogue names, in order of their first rows."""

    def begin(self, journal: ArchivedJournal) -> None:
        """Enter a journal into the catalogue, without segments.

        Raises:
            DoubledSegmentError: Another run has entered it.
        """

    def add(self, segment: Segment, table: pa.Table) -> None:
        """Store a segment and enter it into the catalogue: when this returns, it is durable; before, it is not there.

        Args:
            segment: The segment. It must follow from the last one of its journal.
            table: Its rows, with the columns of `SCHEMA`.

        Raises:
            DoubledSegmentError: Another run has stored these rows.
        """

    def prove(self, journal: JournalName, head: bytes) -> None:
        """Store the head whose signature proves all rows of a journal that are in the archive.

        Args:
            journal: Name of the journal.
            head: Bytes of the head file.
        """

    def read(self, segment: Segment) -> pa.Table:
        """Return the rows of a segment with the columns of `SCHEMA`; `check_table` checks them.

        Raises:
            MissingSegmentError: It is not there.
            AlteredSegmentError: It cannot be read, or is not what was stored.
        """

    def ask(self, sql: str) -> AbstractContextManager[pa.RecordBatchReader]:
        """Answer a question about the table ``rows``, which has all rows of all journals and the columns of `SCHEMA`.

        Args:
            sql: One SELECT.

        Raises:
            ArchiveError: The statement is not one SELECT, or has an error.
            MissingSegmentError: A segment is not there: the answer would be wrong.
        """

    def unlisted(self) -> Sequence[str]:
        """Return what is stored as a segment and is not in the catalogue, as after a run that was killed."""

    def close(self) -> None:
        """Close the archive."""
