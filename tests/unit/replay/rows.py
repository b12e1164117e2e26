"""Rows of a journal as tests need them: by what matters, and the rest as it may be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pcmrs.journal import JournalRow, StoredRow
from pcmrs.journal.rows import GENESIS
from pcmrs.messages import BlueprintTag, Reason, Verdict

TAG = BlueprintTag(id="ratms", version="1", hash="0")


def _row(kind: Any, name: str, command: str | None, source: str, **fields: Any) -> JournalRow:
    branch, _, operation = name.rpartition(".")
    return JournalRow(
        kind=kind,
        wall=1.8e9,
        monotonic=10.0,
        boot_id="b",
        session_id="s",
        blueprint=TAG,
        source=source,
        command_id=command,
        branch=branch or None,
        operation=operation,
        **fields,
    )


def intent(name: str, command: str = "c1", states: dict[str, str] | None = None) -> JournalRow:
    return _row("intent", name, command, "bus:test", states=states)


def outcome(
    name: str,
    command: str = "c1",
    decision: Any = "accepted",
    *,
    reason: Reason | None = None,
    sequence: int = 1,
    states: dict[str, str] | None = None,
    data: dict[str, Any] | None = None,
    result: dict[str, Any] | None = None,
    source: str = "bus:test",
) -> JournalRow:
    """The outcome of a command; `data` is what it stored, `result` what its verdict says."""
    branch, _, operation = name.rpartition(".")
    verdict = Verdict(
        id=command,
        branch=branch,
        operation=operation,
        decision=decision,
        state=(states or {}).get(branch, "0"),
        sequence=sequence,
        reason=reason,
        result=result,
    )
    return _row("outcome", name, command, source, verdict=verdict, states=states, result=data)


def event(code: str, source: str = "robot", *, danger: bool = False, text: str = "") -> JournalRow:
    return _row("device", code, None, source, result={"danger": danger, "text": text, "fields": {}})


def stored(rows: Sequence[JournalRow]) -> list[StoredRow]:
    return [
        StoredRow(sequence=number, row=each, previous_hash=GENESIS, hash=GENESIS) for number, each in enumerate(rows, 1)
    ]
