"""Archived journals and their segments: consecutive rows of one journal, which are archived together."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

from pcmrs.errors import AlteredSegmentError, ArchiveError, DoubledSegmentError, MissingSegmentError
from pcmrs.journal.rows import START, RowPosition

SEGMENT_ROWS: Final = 20_000
"""Largest number of rows of a segment: some 40 MB in memory, and little work that a killed run loses."""

REMEDY: Final = (
    "Put it back from a copy of the archive, or make a new archive from the journals; keep this one unchanged until "
    "you know what has happened."
)
"""Advice for a damaged archive."""

_PART: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,62}")
"""Form of the parts of a name. They become folders, so none may lead out of the archive."""
_FIRST_DIGITS: Final = 16


class JournalName(NamedTuple):
    """Name of a journal in an archive.

    Attributes:
        site: Site of its cell.
        cell: Name of its cell.
        workflow: Id of the blueprint of its first row.
        first: Hash of its first row, the first 16 hexadecimal digits. It tells apart two journals of one cell, and
            recognizes one journal in two places.
    """

    site: str
    cell: str
    workflow: str
    first: str

    def __str__(self) -> str:
        return f"{self.site}/{self.cell}/{self.workflow}-{self.first}"

    @classmethod
    def of(cls, site: str, cell: str, workflow: str, first_hash: bytes) -> Self:
        """Return the name of a journal.

        Args:
            site: Site of its cell.
            cell: Name of its cell.
            workflow: Id of the blueprint of its first row.
            first_hash: Hash of its first row.

        Raises:
            ArchiveError: A part cannot be the name of a folder.
        """
        for part in (site, cell, workflow):
            if not _PART.fullmatch(part):
                text = (
                    f"{part!r} cannot be part of a name in an archive: use 1 to 63 letters, digits, '.', '_' and '-', "
                    "beginning with a letter, a digit or '_'. Give the cell another name with --cell SITE/NAME."
                )
                raise ArchiveError(text, part=part)
        return cls(site, cell, workflow, first_hash.hex()[:_FIRST_DIGITS])


@dataclass(frozen=True, slots=True)
class Segment:
    """Consecutive rows of a journal.

    Attributes:
        journal: Name of the journal.
        start: Position before its first row.
        end: Position of its last row.
    """

    journal: JournalName
    start: RowPosition
    end: RowPosition

    @property
    def first(self) -> int:
        """Sequence of its first row."""
        return self.start.sequence + 1

    @property
    def last(self) -> int:
        """Sequence of its last row."""
        return self.end.sequence

    @property
    def rows(self) -> int:
        """Number of its rows."""
        return self.end.sequence - self.start.sequence

    def __str__(self) -> str:
        return f"segment {self.first}–{self.last} of {self.journal}"


def missing(journal: JournalName, first: int, last: int, what: str) -> MissingSegmentError:
    """Return the error for rows that an archive lacks.

    Args:
        journal: Name of the journal.
        first: Sequence of the first of these rows.
        last: Sequence of the last of these rows.
        what: What is missing, and where.
    """
    text = f"Rows {first}–{last} of {journal} are missing: {what}. {REMEDY}"
    return MissingSegmentError(text, **_fields(journal, first, last))


def altered(journal: JournalName, first: int, last: int, what: str) -> AlteredSegmentError:
    """Return the error for rows that are not those that were archived.

    Args:
        journal: Name of the journal.
        first: Sequence of the first of these rows.
        last: Sequence of the last of these rows.
        what: What differs from what.
    """
    text = f"Rows {first}–{last} of {journal} were altered: {what}. {REMEDY}"
    return AlteredSegmentError(text, **_fields(journal, first, last))


def doubled(journal: JournalName, first: int, last: int, what: str) -> DoubledSegmentError:
    """Return the error for rows that an archive has, or would have, twice.

    Args:
        journal: Name of the journal.
        first: Sequence of the first of these rows.
        last: Sequence of the last of these rows.
        what: Where they are twice, and what to do.
    """
    return DoubledSegmentError(f"Rows {first}–{last} of {journal}: {what}", **_fields(journal, first, last))


def added_by_another_run(journal: JournalName, last: int = 0, segment: Segment | None = None) -> DoubledSegmentError:
    """Return the error for rows that another run adds at the same time.

    Args:
        journal: Name of the journal.
        last: Sequence of the last row that the archive has.
        segment: Segment that was to be added; None for the journal itself.
    """
    first, end = (1, 1) if segment is None else (segment.first, segment.last)
    what = f"the archive has rows up to {last}, from another run at the same time. Run the command again."
    return doubled(journal, first, end, what)


def follow_segments(journal: JournalName, segments: Iterable[Segment]) -> RowPosition:
    """Return the end of a journal's segments, which must follow each other without gap or overlap.

    Args:
        journal: Name of the journal.
        segments: Its segments, in order of their first rows.

    Raises:
        MissingSegmentError: There is a gap before a segment.
        DoubledSegmentError: Two segments hold the same row.
        AlteredSegmentError: A segment does not follow from the one before it.
    """
    end = START
    for segment in segments:
        if segment.start.sequence > end.sequence:
            raise missing(journal, end.sequence + 1, segment.start.sequence, f"{segment} follows row {end.sequence}")
        if segment.start.sequence < end.sequence:
            what = f"{segment} has rows that the segment before it has, too. {REMEDY}"
            raise doubled(journal, segment.first, min(segment.last, end.sequence), what)
        if segment.start != end:
            raise altered(journal, segment.first, segment.last, "they do not follow from the row before them")
        end = segment.end
    return end


def _fields(journal: JournalName, first: int, last: int) -> dict[str, object]:
    return {"journal": str(journal), "cell": f"{journal.site}/{journal.cell}", "first": first, "last": last}
