"""The journal of a replay: what is decided anew, beside what is on record, and durable when the record shows it was."""

from __future__ import annotations

import asyncio
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from pcmrs.journal import StoredRow
from pcmrs.messages import Command, DeviceEvent, Verdict
from pcmrs.replay.durability import held_until
from pcmrs.replay.keys import Key, command_key, event_key, key_of


@dataclass(eq=False)
class Decided:
    """A row that is written anew.

    Attributes:
        states: As the dispatcher hands them to the journal.
        changes: Of the procedure's data, as plain data.
        index: Of the row on record with which it is compared; None where there is none.
        durable: Set when the dispatcher may believe that it is on the disk.
    """

    key: Key
    states: dict[str, str]
    durable: asyncio.Future[None]
    verdict: Verdict | None = None
    changes: dict[str, Any] | None = None
    index: int | None = None


@dataclass
class ReplayRecorder:
    """Implements `pcmrs.dispatcher.Recorder`: nothing is durable before the rows on record allow it.

    Attributes:
        rows: Of one run of the daemon, those that its dispatcher wrote.
        asked: Source and id of every command that the dispatcher has been asked for.
        extra: What was decided anew and is not on record.
        ended: Everything is durable at once: nothing is compared any more.
    """

    rows: Sequence[StoredRow]
    asked: set[tuple[str, str]] = field(default_factory=set)
    extra: list[Decided] = field(default_factory=list)
    ended: bool = False

    def __post_init__(self) -> None:
        self._at: dict[int, Decided] = {}
        self._waiting: list[Decided] = []
        self._held_until = held_until([stored.row for stored in self.rows])
        self._left: dict[Key, deque[int]] = defaultdict(deque)
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
        """See `Recorder.recall`; a repeat leaves no row, so that none is ever replayed."""
        self.asked.add((source, command_id))

    # -- what the replay calls --------------------------------------------------------------------------

    def decided(self, index: int) -> Decided | None:
        """What was decided anew for a row on record, so far."""
        return self._at.get(index)

    def outcome_of(self, command: Command) -> tuple[int, StoredRow] | None:
        """The outcome on record of a command that has not been decided anew; None where it never came."""
        left = self._left.get(command_key("outcome", command))
        return (left[0], self.rows[left[0]]) if left else None

    def release(self, before: int) -> None:
        """Make durable what was, as far as the rows on record show, before the one at `before` was written.

        Events stay as they are: nobody but those who wait for them to be durable can tell.
        """
        for each in self._in_order(before):
            if each.key.kind == "device":
                continue
            if each.index is not None and self._held_until[each.index] >= before:
                break
            self._make_durable(each)

    def release_event(self, before: int, source: str = "") -> bool:
        """Make the first event durable that is not, of those before the row at `before`; whether there was one.

        Args:
            before: Index of a row on record.
            source: Only of this source, or of the device that is meant by it.
        """
        sources = (source, source.removeprefix("device:"))
        events = (each for each in self._in_order(before) if each.key.kind == "device")
        return self._release_first(each for each in events if not source or each.key.source in sources)

    def release_any(self, before: int) -> bool:
        """Make the first row durable that is not, whatever the record shows; whether there was one."""
        return self._release_first(iter(self._in_order(before)))

    def holds_locks(self, name: str) -> bool:
        """Return whether a decision on an operation of that name is not durable yet."""
        return any(each.key.kind == "outcome" and each.key.what == name for each in self._waiting)

    def end(self) -> None:
        """Let the dispatcher come to its end."""
        self.ended = True
        for each in self._waiting:
            if not each.durable.done():
                each.durable.set_result(None)

    def _in_order(self, before: int) -> list[Decided]:
        """What is not durable and was before the row at `before`, or is not on record at all."""
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

    def _write(self, key: Key, states: Mapping[str, str], **more: Any) -> asyncio.Future[None]:
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
