"""Where a decision made anew is another one than the decision on record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import Verdict
from pcmrs.replay.durability import name_of
from pcmrs.replay.keys import event_key
from pcmrs.replay.recorder import Decided

RELATIVE, ABSOLUTE = 1e-9, 1e-12
"""Numbers worked out anew may differ so much: another machine's linear algebra rounds differently."""


class Difference(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=False):
    """One thing that was decided differently.

    Attributes:
        sequence: Of the row on record; that of the next one for a row that is not on record.
        row: Kind, operation or event, and source.
        what: ``row`` where there is none on one side, otherwise what differs in it.
        recorded: On record; None where there is nothing.
        decided: Decided anew; None where nothing was.
    """

    sequence: int
    row: str
    what: str
    recorded: Any = None
    decided: Any = None


def missing(stored: StoredRow) -> Difference:
    """A row on record for which nothing was decided anew."""
    row = stored.row
    verdict = row.verdict
    told = verdict.decision if verdict is not None else row.kind
    return Difference(sequence=stored.sequence, row=_name(row), what="row", recorded=_with_code(told, verdict))


def added(sequence: int, decided: Decided) -> Difference:
    """A row that is not on record."""
    key, verdict = decided.key, decided.verdict
    told = _with_code(verdict.decision if verdict is not None else key.kind, verdict)
    name = f"{key.kind} {key.what} [{key.source}]"
    return Difference(sequence=sequence, row=name, what="row", decided=told)


def reported_already(decided: Decided, rows: Sequence[StoredRow]) -> bool:
    """Return whether it only says again that a hold was not confirmed.

    Of several holds that were pending at once, a journal does not say which one was confirmed, and when.
    """
    unconfirmed = event_key(decided.key.source, NOT_CONFIRMED, danger=True)
    return decided.key == unconfirmed and any(stored.row.operation == NOT_CONFIRMED for stored in rows)


def compared(stored: StoredRow, decided: Decided) -> Iterator[Difference]:
    """What differs between a row on record and its counterpart."""
    for what, before, now in _pairs(stored.row, decided):
        if not same(before, now):
            name = _name(stored.row)
            yield Difference(sequence=stored.sequence, row=name, what=what, recorded=before, decided=now)


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
    """Return whether two pieces of plain data are equal, numbers but for rounding."""
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


def _with_code(told: str, verdict: Verdict | None) -> str:
    code = _code(verdict) if verdict is not None else None
    return told if code is None else f"{told}: {code}"


def _name(row: JournalRow) -> str:
    what = name_of(row) if row.branch else (row.operation or "")
    return f"{row.kind} {what} [{row.source}]"
