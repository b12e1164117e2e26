"""Verification of a whole archive: each row, each column, and the signed head of each journal."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from pcmrs.archive._columns import check_table
from pcmrs.archive._segment import Segment, altered, follow_segments, missing
from pcmrs.archive._store import ArchivedJournal, ArchiveStore, Progress
from pcmrs.errors import ArchiveError, JournalError
from pcmrs.journal.head import Head, parse_head
from pcmrs.journal.keys import parse_public_key
from pcmrs.journal.rows import START
from pcmrs.messages import Message


class ArchiveProblem(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A problem of an archive.

    Attributes:
        code: Code of the error, such as ``segment_missing``.
        journal: Name of the journal.
        text: Segment, rows and what to do.
    """

    code: str
    journal: str
    text: str


class VerifiedJournal(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result for one journal.

    Attributes:
        journal: Name of the journal.
        key: SHA-256 of its public key, hexadecimal. Compare it with ``sha256sum journal.pub`` at the cell.
        segments: Number of its segments.
        rows: Number of its rows that are whole.
        unproven: Number of its last rows that no signed head names yet, because a run was killed. The next run of
            `pcmrs archive add` proves them.
    """

    journal: str
    key: str
    segments: int
    rows: int
    unproven: int


class ArchiveVerification(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a verification.

    Attributes:
        journals: Results by journal.
        unlisted: What is stored as a segment and is not in the catalogue, as after a run that was killed.
        problems: Problems; empty if the archive is whole.
    """

    journals: tuple[VerifiedJournal, ...]
    unlisted: tuple[str, ...]
    problems: tuple[ArchiveProblem, ...]

    @property
    def sound(self) -> bool:
        """True if the archive is complete and unchanged."""
        return not self.problems


def verify_archive(
    store: ArchiveStore, *, keys: Mapping[str, bytes] | None = None, progress: Progress = lambda *_: None
) -> ArchiveVerification:
    """Verify all journals of an archive, and continue after a problem.

    Args:
        store: The archive.
        keys: Public keys, PEM, by cell as ``site/name``, for cells whose key was kept elsewhere: they show that a
            journal was not replaced together with its key.
        progress: Callback for the number of segments read.

    Raises:
        ArchiveError: The catalogue cannot be read.
    """
    journals = [(journal, store.segments(journal.name)) for journal in store.journals()]
    total, done = sum(len(segments) for _, segments in journals), 0
    results: list[VerifiedJournal] = []
    problems: list[ArchiveProblem] = []
    for journal, segments in journals:
        whole = 0
        for segment in segments:
            bad = _attempt(journal, partial(_check_segment, store, segment))
            problems.extend(bad)
            whole += 0 if bad else segment.rows
            done += 1
            progress(str(journal.name), done, total)
        problems.extend(_attempt(journal, partial(follow_segments, journal.name, segments)))
        problems.extend(_attempt(journal, partial(_check_head, journal, segments, keys or {})))
        results.append(_result(journal, segments, whole))
    return ArchiveVerification(journals=tuple(results), unlisted=tuple(store.unlisted()), problems=tuple(problems))


def _attempt(journal: ArchivedJournal, check: Callable[[], object]) -> list[ArchiveProblem]:
    """Return the problem that a check finds, if any."""
    try:
        check()
    except (ArchiveError, JournalError) as error:
        return [ArchiveProblem(code=error.code, journal=str(journal.name), text=error.text)]
    return []


def _check_segment(store: ArchiveStore, segment: Segment) -> None:
    check_table(segment, store.read(segment))


def _check_head(journal: ArchivedJournal, segments: Sequence[Segment], keys: Mapping[str, bytes]) -> None:
    """Require that the archive has the row that the signed head names.

    Raises:
        MissingSegmentError: The last rows are missing.
        AlteredSegmentError: The row is another one, or the head was not signed with the key.
        JournalError: A key cannot be read.
    """
    name = journal.name
    last = segments[-1].last if segments else 0
    own = keys.get(f"{name.site}/{name.cell}", journal.key)
    if _fingerprint(own) != _fingerprint(journal.key):
        raise altered(name, 1, last, f"its public key is not the one that was given for {name.site}/{name.cell}")
    if not journal.head:  # the first run was killed: no row is proven yet
        return
    head = _head(journal)
    if head is None:
        raise altered(name, 1, last, "its head is not signed with its public key")
    if head.place.sequence > last:
        raise missing(name, last + 1, head.place.sequence, f"the signed head names row {head.place.sequence}")
    if head.place != START and head.place not in {segment.end for segment in segments}:
        raise altered(name, 1, last, f"the signed head names another row {head.place.sequence}")


def _result(journal: ArchivedJournal, segments: Sequence[Segment], whole: int) -> VerifiedJournal:
    try:
        head = _head(journal)
    except JournalError:  # it is among the problems
        head = None
    named = 0 if head is None else head.place.sequence
    return VerifiedJournal(
        journal=str(journal.name),
        key=_fingerprint(journal.key),
        segments=len(segments),
        rows=whole,
        unproven=max(0, (segments[-1].last if segments else 0) - named),
    )


def _head(journal: ArchivedJournal) -> Head | None:
    return parse_head(journal.head, parse_public_key(journal.key, f"the key of {journal.name}")).head


def _fingerprint(key: bytes) -> str:
    return hashlib.sha256(key).hexdigest()
