"""Placements as the journal of a cell has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pcmrs.analysis.placements import Recorded
from pcmrs.errors import FileFormatError, GeometryError
from pcmrs.formats.pose_file import Placement
from pcmrs.journal import JournalReader
from pcmrs.spatial import Transform


def read_journalled(path: Path, standoff_mm: float | None) -> list[Recorded]:
    """The accepted `confirm` operations of a journal, in order; each is named by its row.

    Args:
        path: Of the journal.
        standoff_mm: Of all of them; None for the offset that each has on record, none being 0.

    Raises:
        JournalError: The journal cannot be read.
        FileFormatError: There are none, or one holds no poses.
    """
    with JournalReader(path) as reader:
        outcomes = list(reader.read(kind="outcome", branch="placement"))
    recorded = [
        _journalled(path, stored.sequence, verdict.result or {}, standoff_mm)
        for stored in outcomes
        if (verdict := stored.row.verdict) is not None
        if (verdict.operation, verdict.decision) == ("confirm", "accepted")
    ]
    if not recorded:
        raise FileFormatError(f"{path} holds no accepted placement.confirm: nothing was placed.", file=str(path))
    return recorded


def _journalled(path: Path, sequence: int, result: dict[str, Any], standoff_mm: float | None) -> Recorded:
    offset = result.get("confirm_offset", 0.0) if standoff_mm is None else standoff_mm / 1000.0
    try:
        planned, measured = (
            Transform.from_quat_xyzw(result[key]["position"], result[key]["quat_xyzw"])
            for key in ("planned", "measured")
        )
    except (KeyError, TypeError, GeometryError):
        text = f"{path} holds no planned and measured pose in row {sequence}, an accepted placement.confirm."
        raise FileFormatError(text, file=str(path), sequence=sequence) from None
    return Recorded(Placement(str(sequence), planned, measured), offset)
