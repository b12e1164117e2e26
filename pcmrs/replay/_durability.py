"""Times at which decisions became durable, and so took effect, as far as later rows show them.

The dispatcher decides while earlier decisions are still being written to the disk: it sees states, locks and latch as
they were before. The journal does not contain that time, but decisions made meanwhile show it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pcmrs.journal import JournalRow
from pcmrs.replay._keys import is_danger, is_rejection, same_reason

WINDOW = 64
"""Number of rows after a decision that may have been decided without it; no group of rows is larger."""


def held_until(rows: Sequence[JournalRow]) -> list[int]:
    """Return for each row the index of the last one decided before it was durable; its own index if there is none.

    Args:
        rows: Rows that the dispatcher wrote in one run of the daemon.
    """
    held = [_last_without(rows, index) for index in range(len(rows))]
    for first, stop in rejected_by_stop(rows):
        blocking = _only_pending_decision(rows, first)
        if blocking is not None:
            held[blocking] = max(held[blocking], stop)
    return held


def rejected_by_stop(rows: Sequence[JournalRow]) -> Iterator[tuple[int, int]]:
    """Yield the index of the first waiting command that a Stop rejected, and the index of that Stop, for each Stop."""
    for stop, row in enumerate(rows):
        if is_danger(row):
            text = (row.result or {}).get("text", "")
            first = stop
            while first > 0 and is_rejection(rows[first - 1]) and same_reason(rows[first - 1], row.operation, text):
                first -= 1
            if first < stop:
                yield first, stop


def _only_pending_decision(rows: Sequence[JournalRow], index: int) -> int | None:
    """Return the decision that a command at `index` waited for: the last one, if no operation was in progress."""
    under_way: set[tuple[str | None, str | None]] = set()
    last = None
    for each, row in enumerate(rows[:index]):
        key = (row.source, row.command_id)
        if row.kind == "intent":
            under_way.add(key)
        elif row.kind == "outcome":
            under_way.discard(key)
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
    """Return whether the intent was written together with its outcome, and so shows the states after it."""
    pair = rows[index : index + 2]
    return (
        len(pair) == 2 and len({(row.source, row.command_id) for row in pair}) == 1 and pair[0].states == pair[1].states
    )


def _sees_older_commit(decision: JournalRow, rejection: JournalRow) -> bool:
    """Return whether a rejection was made before the commit of a decision: it names the dispatcher's newest commit."""
    if decision.verdict is None or rejection.verdict is None or is_rejection(decision):
        return False
    return rejection.verdict.sequence < decision.verdict.sequence


def _finds_it_running(rows: Sequence[JournalRow], index: int, later: int) -> bool:
    """Return whether a command was rejected as busy since the decision still held its locks, until it was durable."""
    decision = rows[index]
    if name_of(decision) not in running_operations(rows[later]) or not _held_locks(decision):
        return False
    return all(name_of(row) != name_of(decision) for row in rows[index + 1 : later])


def _held_locks(decision: JournalRow) -> bool:
    """Return whether the command held locks: it was performed, or rejected by a check."""
    reason = decision.verdict.reason if decision.verdict is not None else None
    return not is_rejection(decision) or (reason is not None and "check" in reason.fields)


def running_operations(row: JournalRow) -> list[str]:
    """Return the operations that ran when a command was rejected as busy; empty for all other rows."""
    reason = row.verdict.reason if row.verdict is not None else None
    return list(reason.fields.get("running", ())) if reason is not None and reason.code == "busy" else []


def name_of(row: JournalRow) -> str:
    """Return branch and operation of a row, joined by a dot."""
    return f"{row.branch}.{row.operation}"


def _changed(rows: Sequence[JournalRow], index: int) -> dict[str, str]:
    """Return the branches that the decision moved, with their new states; all if no earlier row shows states."""
    after = rows[index].states or {}
    before = next((row.states for row in reversed(rows[:index]) if row.kind != "intent" and row.states), None)
    return {name: state for name, state in after.items() if before is None or before.get(name) != state}


def _moves(rows: Sequence[JournalRow], branch: str, state: str) -> bool:
    """Return whether one of the decisions moved the branch into another state."""
    return any(row.kind == "outcome" and (row.states or {}).get(branch, state) != state for row in rows)
