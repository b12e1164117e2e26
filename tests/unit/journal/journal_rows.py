"""Rows for journal tests."""

from __future__ import annotations

from typing import Any

from pcmrs.journal import JournalRow, Kind
from pcmrs.journal.rows import encode_row
from pcmrs.messages import BlueprintTag, Verdict

BLUEPRINT = BlueprintTag(id="ratms", version="1", hash="ab" * 32)


def row(kind: Kind = "event", **fields: Any) -> JournalRow:
    return JournalRow(
        kind=kind, wall=1.7e9, monotonic=12.5, boot_id="boot", session_id="session", blueprint=BLUEPRINT, **fields
    )


def intent(command_id: str, source: str = "bus:local") -> JournalRow:
    return row(
        "intent",
        command_id=command_id,
        source=source,
        branch="registration",
        operation="register",
        arguments={"landmarks": [[0.1, -2.0, 3e-9]], "name": "p0"},
    )


def outcome(command_id: str, source: str = "bus:local") -> JournalRow:
    verdict = Verdict(
        id=command_id,
        branch="registration",
        operation="register",
        decision="accepted",
        state="111",
        sequence=4,
        result={"residual": 0.0023},
    )
    return row(
        "outcome",
        command_id=command_id,
        source=source,
        branch="registration",
        operation="register",
        verdict=verdict,
        states={"registration": "111"},
        result={"residual": 0.0023},
    )


ROW = (row(), encode_row(row()))
