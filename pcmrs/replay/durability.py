"""When a decision became durable, and so true, as far as later rows show it.

The dispatcher decides while earlier decisions are still on their way to the disk: it sees their states, locks and
latch as they were before. The journal says nothing of that moment, but what was decided meanwhile does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pcmrs.journal import JournalRow
from pcmrs.replay.keys import is_danger, is_rejection, same_reason

WINDOW = 64
"""Rows after a decision among which one may have been decided without it; a group of rows is not larger."""


def held_until(rows: Sequence[JournalRow]) -> list[int]:
    """For each row the index of the last one that was decided while it was not durable; its own where none was.

    Args:
        rows: Of one run of the daemon, what its dispatcher wrote.
    """
    held = [_last_without(rows, index) for index in range(len(rows))]
    for first, stop in turned_away(rows):
        blocking = _only_decision_in_the_way(rows, first)
        if blocking is not None:
            held[blocking] = max(held[blocking], stop)
    return held


def turned_away(rows: Sequence[JournalRow]) -> Iterator[tuple[int, int]]:
    """Where commands that waited were rejected because of a Stop: index of the first of them, and of that Stop."""
    for stop, row in enumerate(rows):
        if is_danger(row):
            text = (row.result or {}).get("text", "")
            first = stop
            while first > 0 and is_rejection(rows[first - 1]) and same_reason(rows[first - 1], row.operation, text):
                first -= 1
            if first < stop:
                yield first, stop


def _only_decision_in_the_way(rows: Sequence[JournalRow], index: int) -> int | None:
    """What a command at `index` can have waited for where no operation was under way: the decision before it."""
    under_way: set[tuple[str | None, str | None]] = set()
    last = None
    for each, row in enumerate(rows[:index]):
        asked = (row.source, row.command_id)
        if row.kind == "intent":
            under_way.add(asked)
        elif row.kind == "outcome":
            under_way.discard(asked)
            last = each
    return None if under_way else last


def _last_without(rows: Sequence[JournalRow], index: int) -> int:
    if rows[index].kind != "outcome":
        return index
    changed = _changed(rows, index)
    last = index
    for later in range(index + 1, min(index + WINDOW, len(rows))):
        if _without(rows, index, later, changed):
            last = later
    return last


def _without(rows: Sequence[JournalRow], index: int, later: int, changed: dict[str, str]) -> bool:
    row = rows[later]
    if is_rejection(row):
        return _sees_older_commit(rows[index], row) or _finds_it_running(rows, index, later)
    if row.kind != "intent" or row.states is None or _is_journalled_with_outcome(rows, later):
        return False
    between = rows[index + 1 : later]
    return any(
        row.states.get(branch) != state and not _moves(between, branch, state) for branch, state in changed.items()
    )


def _is_journalled_with_outcome(rows: Sequence[JournalRow], index: int) -> bool:
    """Return whether the intent was written together with its outcome: then it shows the states after that."""
    pair = rows[index : index + 2]
    return (
        len(pair) == 2 and len({(row.source, row.command_id) for row in pair}) == 1 and pair[0].states == pair[1].states
    )


def _sees_older_commit(decision: JournalRow, rejection: JournalRow) -> bool:
    """A rejection tells the newest commit that its dispatcher had made."""
    if decision.verdict is None or rejection.verdict is None or is_rejection(decision):
        return False
    return rejection.verdict.sequence < decision.verdict.sequence


def _finds_it_running(rows: Sequence[JournalRow], index: int, later: int) -> bool:
    """A command is rejected as busy because of those that hold their locks until their decision is durable."""
    decision = rows[index]
    if name_of(decision) not in busy_with(rows[later]) or not _held_locks(decision):
        return False
    return all(name_of(row) != name_of(decision) for row in rows[index + 1 : later])


def _held_locks(decision: JournalRow) -> bool:
    """Return whether the command was begun: performed, or rejected by a check of its own."""
    reason = decision.verdict.reason if decision.verdict is not None else None
    return not is_rejection(decision) or (reason is not None and "check" in reason.fields)


def busy_with(row: JournalRow) -> list[str]:
    """What was running when a command was rejected as busy; empty for all other rows."""
    reason = row.verdict.reason if row.verdict is not None else None
    return list(reason.fields.get("running", ())) if reason is not None and reason.code == "busy" else []


def name_of(row: JournalRow) -> str:
    """Branch and operation."""
    return f"{row.branch}.{row.operation}"


def _changed(rows: Sequence[JournalRow], index: int) -> dict[str, str]:
    """Branches that the decision moved, and where to; all of them where no row before it shows any."""
    after = rows[index].states or {}
    before = next((row.states for row in reversed(rows[:index]) if row.kind != "intent" and row.states), None)
    return {name: state for name, state in after.items() if before is None or before.get(name) != state}


def _moves(rows: Sequence[JournalRow], branch: str, state: str) -> bool:
    """Return whether one of the decisions moved the branch elsewhere."""
    return any(row.kind == "outcome" and (row.states or {}).get(branch, state) != state for row in rows)
