"""Rows that the journal writes about itself: after a crash or a failure, and when it adopts an older version."""

from __future__ import annotations

from pcmrs.clock import SystemClock
from pcmrs.errors import JournalError
from pcmrs.journal.rows import JournalRow, RowPosition
from pcmrs.journal.schema import HEADLESS, WITHOUT_MAC
from pcmrs.journal.soundness import WritableJournal

SOURCE = "journal"
"""Source of rows that the journal writes about itself."""
CONTINUED = "continued"
"""Operation of the first row of each file but the first."""
RESTORED = "restored"
"""Operation of the row that follows the rows of a backup."""


def note_rows(found: WritableJournal) -> list[JournalRow]:
    """Return the rows to be journalled about what was found when the journal was opened.

    They belong to the session of the row before them and have its time of the cell's clock, which does not run yet.
    """
    rows = []
    if found.last is not None and found.version == HEADLESS:
        text = f"A signed head was begun for a journal of version {HEADLESS}, after all its rows were found whole."
        rows.append(_note(found.last.row, "head_begun", {"text": text, "rows": found.place.sequence}))
    if found.last is not None and HEADLESS < found.version <= WITHOUT_MAC:
        text = f"The journal was of version {found.version}: rows up to here have no MAC; the head proves them."
        rows.append(_note(found.last.row, "mac_begun", {"text": text, "rows": found.place.sequence}))
    if found.last is not None and found.unnamed:
        text = f"The writer died before its head named the last rows, {found.unnamed} of them: they are taken up."
        rows.append(_note(found.last.row, "head_behind", {"text": text, "rows": found.unnamed}))
    if found.last is not None and found.damaged:
        text = "A slot of the head could not be read, as after a power cut: the other one held."
        rows.append(_note(found.last.row, "head_damaged", {"text": text, "slots": found.damaged}))
    return rows


def reopened_rows(found: WritableJournal, why: JournalError | None) -> list[JournalRow]:
    """Return the row that reports a reopening after a failure; none if the journal has no rows yet.

    Args:
        found: Journal as it was found on the disk.
        why: The failure; None if it is unknown.
    """
    if found.last is None:
        return []
    text = f"The journal was reopened, and what the disk has was read again. {why.text if why is not None else ''}"
    return [_note(found.last.row, "reopened", {"text": text.rstrip()})]


def continued_row(before: JournalRow, earlier: str, place: RowPosition) -> JournalRow:
    """Return the first row of a new file that continues an earlier one.

    Args:
        before: Last row of the earlier file.
        earlier: Name of the earlier file.
        place: Position of that row.
    """
    text = f"The journal has grown and goes on in this file, after row {place.sequence} of {earlier}."
    result = {"text": text, "earlier": earlier, "rows": place.sequence, "hash": place.hash.hex()}
    return _note(before, CONTINUED, result)


def restored_row(before: JournalRow, made: str, program: str, rows: int) -> JournalRow:
    """Return the row that reports that a journal was restored from a backup.

    Args:
        before: Last row of the backup.
        made: Time of the backup, ISO 8601.
        program: Version of PCMRS that made the backup.
        rows: Sequence of the last row of the backup.
    """
    text = (
        f"The cell was restored from a backup of {made}, which ends with row {rows}. If it ran after that, later rows "
        "are not here: their commands are accepted again if they are repeated, and so are signed commands whose "
        "peer counts by itself. The cell starts latched."
    )
    return _note(before, RESTORED, {"text": text, "made": made, "pcmrs": program, "rows": rows})


def _note(before: JournalRow, operation: str, result: dict[str, object]) -> JournalRow:
    return JournalRow(
        kind="event",
        source=SOURCE,
        operation=operation,
        result=result,
        wall=SystemClock().wall(),
        monotonic=before.monotonic,
        boot_id=before.boot_id,
        session_id=before.session_id,
        blueprint=before.blueprint,
    )
