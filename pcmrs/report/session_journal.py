"""Reader of a session: the outcomes of its operations, from the rows of its journal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from pcmrs.analysis.placements import PlacementTrial
from pcmrs.calibration import KINDS
from pcmrs.errors import FileFormatError, GeometryError, JournalError
from pcmrs.formats.pose_file import Placement
from pcmrs.journal import JournalReader, JournalRow, StoredRow
from pcmrs.messages import Verdict
from pcmrs.spatial import Transform

CONFIRM = "placement.confirm"
"""Operation that measures the tool at its planned pose."""


@dataclass(frozen=True, slots=True)
class JournalledOutcome:
    """The end of one operation.

    Attributes:
        sequence: Sequence of its row.
        row: Its row.
        verdict: Verdict of that row.
    """

    sequence: int
    row: JournalRow
    verdict: Verdict

    @property
    def name(self) -> str:
        """Branch and operation, joined by a dot."""
        return operation_name(self.row)

    @property
    def result(self) -> dict[str, Any]:
        """Result that the verdict reported; empty if it reported none."""
        return self.verdict.result or {}

    @property
    def data(self) -> dict[str, Any]:
        """Procedure data that the operation stored for later decisions; empty if it stored none."""
        return self.row.result or {}

    @property
    def code(self) -> str:
        """Code of the reason; empty if the verdict has no reason."""
        return "" if self.verdict.reason is None else self.verdict.reason.code

    @property
    def text(self) -> str:
        """Text of the reason; empty if the verdict has no reason."""
        return "" if self.verdict.reason is None else self.verdict.reason.text

    def pose(self, key: str) -> Transform | None:
        """Return the pose in a field of the result, in the frame that the operation reports; None if it has none."""
        try:
            return Transform.from_quat_xyzw(self.result[key]["position"], self.result[key]["quat_xyzw"])
        except (KeyError, TypeError, GeometryError):
            return None


class SessionJournal:
    """Rows of a journal, as outcomes of operations.

    Args:
        rows: Rows in order of their sequence.

    Attributes:
        rows: The same rows.
        outcomes: Outcome of each operation that ended, in order.
    """

    def __init__(self, rows: Sequence[StoredRow]) -> None:
        self.rows = tuple(rows)
        self.outcomes = tuple(
            JournalledOutcome(stored.sequence, stored.row, stored.row.verdict)
            for stored in self.rows
            if stored.row.kind == "outcome" and stored.row.verdict is not None
        )

    @classmethod
    def read(cls, path: Path, **filters: Any) -> Self:
        """Read a journal.

        Args:
            path: Journal file.
            filters: Filters of `JournalReader.read`; without any, all rows are read.

        Raises:
            JournalError: The journal cannot be read.
        """
        with JournalReader(path) as reader:
            return cls(tuple(reader.read(**filters)))

    def accepted(self, *operations: str) -> Iterator[JournalledOutcome]:
        """Yield the accepted outcomes of these operations, of all operations if none are named."""
        for outcome in self.outcomes:
            if outcome.verdict.decision == "accepted" and (not operations or outcome.name in operations):
                yield outcome

    def not_accepted(self) -> Iterator[JournalledOutcome]:
        """Yield the outcomes that were rejected, failed or are unknown."""
        return (outcome for outcome in self.outcomes if outcome.verdict.decision != "accepted")

    def unfinished(self) -> Iterator[StoredRow]:
        """Yield the intents of operations that started and have no outcome."""
        ended = {(outcome.row.source, outcome.row.command_id) for outcome in self.outcomes}
        for stored in self.rows:
            if stored.row.kind == "intent" and (stored.row.source, stored.row.command_id) not in ended:
                yield stored

    def stored_data(self, field: str) -> Any:
        """Return the last value of a field of the procedure data; None if it was never stored, or was cleared."""
        results = (stored.row.result for stored in reversed(self.rows))
        return next((result[field] for result in results if result and field in result), None)


def read_placements(path: Path, standoff_mm: float | None) -> list[PlacementTrial]:
    """Return the accepted `confirm` operations of a journal, in order; each is named by the sequence of its row.

    Args:
        path: Journal file.
        standoff_mm: Standoff of all placements, mm; None to use the offset that each has in the journal, or 0.

    Raises:
        JournalError: The journal cannot be read.
        FileFormatError: There are none, or one has no poses.
    """
    journal = SessionJournal.read(path, kind="outcome", branch=CONFIRM.partition(".")[0])
    trials = [_placement(path, outcome, standoff_mm) for outcome in journal.accepted(CONFIRM)]
    if not trials:
        raise FileFormatError(f"{path} holds no accepted placement.confirm: nothing was placed.", file=str(path))
    return trials


def _placement(path: Path, outcome: JournalledOutcome, standoff_mm: float | None) -> PlacementTrial:
    planned, measured = outcome.pose("planned"), outcome.pose("measured")
    if planned is None or measured is None:
        text = f"{path} holds no planned and measured pose in row {outcome.sequence}, an accepted placement.confirm."
        raise FileFormatError(text, file=str(path), sequence=outcome.sequence)
    standoff = outcome.result.get("confirm_offset", 0.0) if standoff_mm is None else standoff_mm / 1000.0
    return PlacementTrial(Placement(str(outcome.sequence), planned, measured), standoff)


def find_session(sessions: Sequence[str], start: str | None, path: Path) -> int:
    """Return the index of the session whose id has this start.

    Args:
        sessions: Ids of the sessions, in order.
        start: Start of the id; None for the last session.
        path: Journal file, for the message.

    Raises:
        JournalError: No session matches, or more than one does.
    """
    found = [index for index, session in enumerate(sessions) if start is None or session.startswith(start)]
    if not found or (start is not None and len(found) > 1):
        last = ", ".join(sessions[-5:]) or "none"
        text = f"{path} has {len(found) or 'no'} sessions that begin with {start or 'anything'}; the last: {last}."
        raise JournalError(text, path=str(path), session=start)
    return found[-1]


def configured_calibrations(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the paths of the calibration files that settings name, by kind: ``tool`` and ``pointer``."""
    calibration = settings.get("procedure", {}).get("calibration", {})
    return {kind: str(file) for kind in KINDS if (file := calibration.get(f"{kind}_file"))}


def operation_name(row: JournalRow) -> str:
    """Return branch and operation of a row, joined by a dot."""
    return f"{row.branch}.{row.operation}"


def source_without_port(source: str | None) -> str:
    """Return the source of a command without its port, which differs from connection to connection."""
    return ":".join((source or "").split(":")[:2])
