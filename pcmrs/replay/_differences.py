"""Differences between replayed and journalled decisions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import Verdict
from pcmrs.replay._durability import name_of
from pcmrs.replay._keys import event_key
from pcmrs.replay._recorder import Decided

RELATIVE, ABSOLUTE = 1e-9, 1e-12
"""Tolerances of recomputed numbers: another machine's linear algebra rounds differently."""


class ReplayDifference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=False):
    """One difference.

    Attributes:
        sequence: Sequence of the journalled row; that of the next one for a row that was not journalled.
        row: Kind, operation or event, and source.
        what: ``row`` if one side has no row, otherwise the part of the row that differs.
        recorded: Journalled value; None if there is none.
        decided: Replayed value; None if there is none.
    """

    sequence: int
    row: str
    what: str
    recorded: Any = None
    decided: Any = None


def missing(stored: StoredRow) -> ReplayDifference:
    """Return the difference for a journalled row that was not decided again."""
    row = stored.row
    verdict = row.verdict
    decision = verdict.decision if verdict is not None else row.kind
    return ReplayDifference(
        sequence=stored.sequence, row=_name(row), what="row", recorded=_with_code(decision, verdict)
    )


def added(sequence: int, decided: Decided) -> ReplayDifference:
    """Return the difference for a decision that was not journalled.

    Args:
        sequence: Sequence of the next journalled row.
        decided: The decision.
    """
    key, verdict = decided.key, decided.verdict
    decision = _with_code(verdict.decision if verdict is not None else key.kind, verdict)
    name = f"{key.kind} {key.what} [{key.source}]"
    return ReplayDifference(sequence=sequence, row=name, what="row", decided=decision)


def reported_already(decided: Decided, rows: Sequence[StoredRow]) -> bool:
    """Return whether a decision only repeats that a hold was not confirmed.

    If several holds were pending at once, a journal does not say which one was confirmed, and when.

    Args:
        decided: Decision that was not journalled.
        rows: Journalled rows of the run.
    """
    unconfirmed = event_key(decided.key.source, NOT_CONFIRMED, danger=True)
    return decided.key == unconfirmed and any(stored.row.operation == NOT_CONFIRMED for stored in rows)


def compared(stored: StoredRow, decided: Decided) -> Iterator[ReplayDifference]:
    """Yield the differences between a journalled row and its replayed counterpart.

    Args:
        stored: Journalled row.
        decided: Replayed decision.
    """
    for what, before, now in _pairs(stored.row, decided):
        if not same(before, now):
            name = _name(stored.row)
            yield ReplayDifference(sequence=stored.sequence, row=name, what=what, recorded=before, decided=now)


def _pairs(row: JournalRow, decided: Decided) -> Iterator[tuple[str, Any, Any]]:
    yield "states", row.states, decided.states
    if row.verdict is not None and decided.verdict is not None:
        yield "decision", row.verdict.decision, decided.verdict.decision
        yield "reason", _code(row.verdict), _code(decided.verdict)
        yield "state", row.verdict.state, decided.verdict.state
        before, now = row.result or {}, decided.changes or {}
        for field in sorted({*before, *now}):
            yield f"data.{field}", before.get(field), now.get(field)


def same(before: Any, now: Any) -> bool:
    """Return whether two pieces of plain data are equal, up to the rounding of numbers.

    Args:
        before: Journalled data.
        now: Replayed data.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        return before.keys() == now.keys() and all(same(value, now[key]) for key, value in before.items())
    if isinstance(before, list | tuple) and isinstance(now, list | tuple):
        return len(before) == len(now) and all(map(same, before, now))
    if isinstance(before, float) or isinstance(now, float):
        numbers = isinstance(before, int | float) and isinstance(now, int | float)
        return numbers and math.isclose(before, now, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
    return bool(before == now)


def _code(verdict: Verdict) -> str | None:
    return verdict.reason.code if verdict.reason is not None else None


def _with_code(decision: str, verdict: Verdict | None) -> str:
    code = _code(verdict) if verdict is not None else None
    return decision if code is None else f"{decision}: {code}"


def _name(row: JournalRow) -> str:
    what = name_of(row) if row.branch else (row.operation or "")
    return f"{row.kind} {what} [{row.source}]"
