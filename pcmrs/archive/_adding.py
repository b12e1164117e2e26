"""Adding the new rows of a journal to an archive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from pcmrs.archive._columns import end_of, table_of
from pcmrs.archive._segment import SEGMENT_ROWS, JournalName, Segment, altered, doubled, follow_segments
from pcmrs.archive._source import JournalSource
from pcmrs.archive._store import ArchivedJournal, ArchiveStore, Progress
from pcmrs.errors import JournalError
from pcmrs.journal.rows import RowPosition
from pcmrs.messages import Message


class AddedRows(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What a run has added of one journal.

    Attributes:
        path: Path of the journal.
        journal: Its name in the archive; empty if the journal has no rows.
        added: Number of rows that were added.
        rows: Number of its rows in the archive.
    """

    path: str
    journal: str
    added: int
    rows: int


def add_journal(
    store: ArchiveStore,
    path: Path,
    *,
    cell: tuple[str, str] | None = None,
    segment_rows: int = SEGMENT_ROWS,
    progress: Progress = lambda *_: None,
) -> AddedRows:
    """Add the rows of a journal that an archive does not have, up to the one that the journal's signed head names.

    All rows are proven before the first one is added. A run that is killed leaves the segments that it has added; the
    next run continues after them.

    Args:
        store: The archive.
        path: First file of the journal; a daemon may be writing it.
        cell: Site and name of its cell; None for those in the journal.
        segment_rows: Largest number of rows of a segment.
        progress: Callback for the number of rows added.

    Raises:
        JournalError: The journal is damaged, or has no head.
        AlteredSegmentError: The journal does not hold what was archived of it: it was set back, or replaced.
        DoubledSegmentError: The archive has this journal under the name of another cell.
        MissingSegmentError: The archive lacks a segment of the journal.
        ArchiveError: The archive cannot be written.
    """
    with JournalSource(path) as source:
        if source.end.sequence == 0:
            return AddedRows(path=str(path), journal="", added=0, rows=0)
        name = source.name(cell)
        known = next((each for each in store.journals() if each.name.first == name.first), None)
        start = _end_of(store, known, name, source)
        source.prove(start)
        if known is None:
            store.begin(ArchivedJournal(name, source.key, b""))
        for end in _add_segments(store, source, name, start, segment_rows):
            progress(str(name), end.sequence - start.sequence, source.end.sequence - start.sequence)
        if known is None or known.head != source.head:
            store.prove(name, source.head)
        added = source.end.sequence - start.sequence
        return AddedRows(path=str(path), journal=str(name), added=added, rows=source.end.sequence)


def find_journals(places: Sequence[Path]) -> list[Path]:
    """Return the first files of all journals at some places.

    Args:
        places: Journals, or folders of cells, whose journals are all meant.

    Raises:
        JournalError: There is nothing, or no journal in a folder.
    """
    found = []
    for place in places:
        inside = sorted(place.glob("*.sqlite")) if place.is_dir() else [place]
        if not inside or not inside[0].exists():
            raise JournalError(
                f"There is no journal {place}: give a journal, or the folder of a cell.", path=str(place)
            )
        found.extend(inside)
    return found


def _add_segments(
    store: ArchiveStore, source: JournalSource, name: JournalName, end: RowPosition, segment_rows: int
) -> Iterator[RowPosition]:
    """Add the proven rows after a position, and yield the end of each segment once it is in the archive.

    A thread stores a segment while the next one is read, because storing waits for compression and the disk.
    """
    with ThreadPoolExecutor(1) as storing:
        pending: Future[None] | None = None
        while end != source.end:
            table = table_of(name, source.read(end, segment_rows))
            segment = Segment(name, end, end_of(table))
            if pending is not None:
                pending.result()
                yield end
            pending = storing.submit(store.add, segment, table)
            end = segment.end
        if pending is not None:
            pending.result()
            yield end


def _end_of(
    store: ArchiveStore, known: ArchivedJournal | None, name: JournalName, source: JournalSource
) -> RowPosition:
    """Return the position up to which the archive has a journal, which must still hold these rows."""
    if known is None:
        return follow_segments(name, ())
    if known.name != name:
        what = f"this journal is in the archive as {known.name}. Add it as that cell, or to another archive."
        raise doubled(name, 1, source.end.sequence, what)
    end = follow_segments(name, store.segments(name))
    if known.key != source.key:
        what = f"journal.pub beside {source.path} is another key than the one in the archive"
        raise altered(name, 1, source.end.sequence, what)
    if not source.has(end):
        what = (
            f"{source.path}, whose head names row {source.end.sequence}, does not have row {end.sequence} as it was "
            "archived: the journal was set back or replaced"
        )
        raise altered(name, 1, end.sequence, what)
    return end
