"""Decisions of a replay, matched with the journalled rows, and durable when those rows show that they were."""

from __future__ import annotations

import asyncio
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from pcmrs.journal import StoredRow
from pcmrs.messages import Command, DeviceEvent, Verdict
from pcmrs.replay._durability import held_until
from pcmrs.replay._keys import RowKey, command_key, event_key, key_of


@dataclass(eq=False)
class Decided:
    """A replayed row.

    Attributes:
        states: States that the dispatcher passed to the journal.
        changes: Changes of the procedure's data, as plain data.
        index: Index of the journalled row with which it is compared; None if there is none.
        durable: Done when the dispatcher may take the row for durable.
    """

    key: RowKey
    states: dict[str, str]
    durable: asyncio.Future[None]
    verdict: Verdict | None = None
    changes: dict[str, Any] | None = None
    index: int | None = None


@dataclass
class ReplayRecorder:
    """Implementation of `pcmrs.dispatcher.Recorder` in which a row becomes durable when the journalled rows allow it.

    Attributes:
        rows: Rows that the dispatcher wrote in one run of the daemon.
        submitted: Source and id of each command that was submitted to the dispatcher.
        extra: Decisions that were not journalled.
        ended: True after the end: all rows are durable at once, and none is compared.
    """

    rows: Sequence[StoredRow]
    submitted: set[tuple[str, str]] = field(default_factory=set)
    extra: list[Decided] = field(default_factory=list)
    ended: bool = False

    def __post_init__(self) -> None:
        self._at: dict[int, Decided] = {}
        self._waiting: list[Decided] = []
        self._held_until = held_until([stored.row for stored in self.rows])
        self._left: dict[RowKey, deque[int]] = defaultdict(deque)
        for index, stored in enumerate(self.rows):
            key = key_of(stored.row)
            if key is not None:
                self._left[key].append(index)

    # -- what the dispatcher calls ----------------------------------------------------------------------

    def intent(self, command: Command, states: Mapping[str, str]) -> asyncio.Future[None]:
        """See `Recorder.intent`."""
        return self._write(command_key("intent", command), states)

    def decision(
        self,
        command: Command,
        verdict: Verdict,
        states: Mapping[str, str],
        changes: Mapping[str, Any],
        *,
        with_intent: bool,
    ) -> asyncio.Future[None]:
        """See `Recorder.decision`."""
        if with_intent:
            self._write(command_key("intent", command), states)
        plain = msgspec.to_builtins(dict(changes)) if changes else None
        return self._write(command_key("outcome", command), states, verdict=verdict, changes=plain)

    def event(self, event: DeviceEvent, states: Mapping[str, str]) -> asyncio.Future[None]:
        """See `Recorder.event`."""
        return self._write(event_key(event.device, event.code, danger=event.danger), states)

    def recall(self, source: str, command_id: str) -> None:
        """See `Recorder.recall`; a repeat leaves no row, so it is never replayed."""
        self.submitted.add((source, command_id))

    # -- what the replay calls --------------------------------------------------------------------------

    def decided(self, index: int) -> Decided | None:
        """Return the decision for the journalled row at `index`; None if it was not made yet."""
        return self._at.get(index)

    def outcome_of(self, command: Command) -> tuple[int, StoredRow] | None:
        """Return index and row of the journalled outcome of a command not decided yet; None if there was no outcome."""
        left = self._left.get(command_key("outcome", command))
        return (left[0], self.rows[left[0]]) if left else None

    def release(self, before: int) -> None:
        """Make the decisions durable that, as the journalled rows show, were durable before the row at `before`.

        Events are left out: only those who wait for them notice when they are durable.
        """
        for each in self._in_order(before):
            if each.key.kind == "device":
                continue
            if each.index is not None and self._held_until[each.index] >= before:
                break
            self._make_durable(each)

    def release_event(self, before: int, source: str = "") -> bool:
        """Make the first event durable that is not yet, of those before a row.

        Args:
            before: Index of the journalled row.
            source: Source of the event, or of its device; empty for any.

        Returns:
            True if there was one.
        """
        sources = (source, source.removeprefix("device:"))
        events = (each for each in self._in_order(before) if each.key.kind == "device")
        return self._release_first(each for each in events if not source or each.key.source in sources)

    def release_any(self, before: int) -> bool:
        """Make the first row durable that is not yet, whatever the journal shows; return whether there was one."""
        return self._release_first(iter(self._in_order(before)))

    def holds_locks(self, name: str) -> bool:
        """Return whether a decision on the operation is not durable yet, so that it holds its locks."""
        return any(each.key.kind == "outcome" and each.key.what == name for each in self._waiting)

    def end(self) -> None:
        """Make all rows durable, so that the dispatcher can end."""
        self.ended = True
        for each in self._waiting:
            if not each.durable.done():
                each.durable.set_result(None)

    def _in_order(self, before: int) -> list[Decided]:
        """Return the rows that are not durable: those before the row at `before`, and those not journalled."""
        waiting = [each for each in self._waiting if each.index is None or each.index < before]
        return sorted(waiting, key=lambda each: -1 if each.index is None else each.index)

    def _release_first(self, rows: Iterator[Decided]) -> bool:
        first = next(rows, None)
        if first is not None:
            self._make_durable(first)
        return first is not None

    def _make_durable(self, row: Decided) -> None:
        self._waiting.remove(row)
        if not row.durable.done():
            row.durable.set_result(None)

    def _write(self, key: RowKey, states: Mapping[str, str], **more: Any) -> asyncio.Future[None]:
        durable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        if self.ended:
            durable.set_result(None)
            return durable
        row = Decided(key, dict(states), durable, **more)
        left = self._left[key]
        if left:
            row.index = left.popleft()
            self._at[row.index] = row
        else:
            self.extra.append(row)
        self._waiting.append(row)
        return durable
