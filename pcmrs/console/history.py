"""The journal as the page tells it: read backwards from its end, a page at a time, and followed from then on."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

from pcmrs.client import Client
from pcmrs.messages import JournalQuery, Verdict
from pcmrs.messages.device import DeviceEvent
from pcmrs.messages.identity import Role

HISTORIANS: tuple[Role, ...] = ("operator", "viewer")
"""Who may ask for the journal."""
PAGE = 200
"""Rows that are asked for at once."""
AT_FIRST = 2000
"""Of a longer session only so many entries are read before somebody asks for more."""
NEWEST = 2**62
"""Larger than the sequence of any row."""
KINDS = {
    "outcome": "kind_outcome",
    "device": "kind_device",
    "event": "kind_event",
    "config": "kind_config",
    "activity": "kind_activity",
}
"""Kinds of entries, and the text for each. Rows of other kinds say nothing by themselves: an intent has its outcome, a
snapshot what led to it."""
ACTIVITY = "activity:"
"""Begins the source of what nobody has asked for, which goes on all the time."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One row, in words.

    Attributes:
        sequence: Of the row.
        wall: Unix seconds.
        session: Id of the session.
        who: User who asked; empty where nobody did.
        what: The operation with what was decided, or the event.
        result: The reason, or the text.
    """

    sequence: int
    wall: float
    kind: str
    session: str
    who: str
    what: str
    result: str


class History:
    """What was read of the journal.

    Attributes:
        entries: Oldest first.
        whole: Nothing is before the oldest.
    """

    def __init__(self) -> None:
        self.entries: deque[Entry] = deque()
        self.whole = False
        self._first, self._last = NEWEST, 0

    async def follow(self, client: Client) -> None:
        """Read what is new; the first time, the session so far.

        Raises:
            UnknownOutcomeError: The daemon did not answer.
        """
        if not self._last:
            await self.reach_back(client)
            while self._within_a_session() and not self.whole and len(self.entries) < AT_FIRST:
                await self.reach_back(client)
            return
        rows: list[dict[str, Any]] = [{}]
        while rows:
            rows = (await client.journal(JournalQuery(after=self._last, limit=PAGE))).rows
            self.entries.extend(_entries(rows))
            self._last = max([self._last, *(row["sequence"] for row in rows)])

    async def reach_back(self, client: Client) -> None:
        """Read the page before what was read.

        Raises:
            UnknownOutcomeError: The daemon did not answer.
        """
        rows = (await client.journal(JournalQuery(before=self._first, limit=PAGE))).rows
        self.entries.extendleft(reversed(list(_entries(rows))))
        sequences = [row["sequence"] for row in rows]
        self._first, self._last = min([self._first, *sequences]), max([self._last, *sequences])
        self.whole = not rows or self._first == 1  # a page ends early where its rows are long

    def _within_a_session(self) -> bool:
        return not self.entries or self.entries[0].session == self.entries[-1].session


def heard_only(events: Iterable[tuple[float, Verdict | DeviceEvent]]) -> list[Entry]:
    """What was heard as if it had been journalled, for whoever may not read the journal; in the same order."""
    return [
        Entry(number, wall, "outcome" if isinstance(event, Verdict) else "device", "", "", heading(event), why(event))
        for number, (wall, event) in enumerate(events)
    ]


def matching(entries: Iterable[Entry], text: str, kinds: Iterable[str], most: int) -> list[Entry]:
    """The first `most` entries of these kinds that have `text` anywhere, whatever its case; no kinds are all kinds."""
    wanted, words = set(kinds), text.casefold()
    found = (
        each
        for each in entries
        if (not wanted or each.kind in wanted) and words in f"{each.who} {each.what} {each.result}".casefold()
    )
    return list(islice(found, most))


def heading(event: Verdict | DeviceEvent) -> str:
    """What was decided or reported, in a few words."""
    if isinstance(event, Verdict):
        return f"{event.branch}.{event.operation}: {event.decision}"
    return f"{event.device}: {event.code}"


def why(event: Verdict | DeviceEvent) -> str:
    """The text that goes with it; empty where there is none."""
    if isinstance(event, DeviceEvent):
        return event.text
    return "" if event.reason is None else event.reason.text


def _entries(rows: Iterable[dict[str, Any]]) -> Iterator[Entry]:
    for stored in rows:
        row = stored["row"]
        if row["kind"] in KINDS:
            yield _entry(stored["sequence"], row)


def _entry(sequence: int, row: dict[str, Any]) -> Entry:
    verdict = row.get("verdict")
    if verdict is None:
        what, result = f"{row['source']}: {row['operation']}", str((row.get("result") or {}).get("text", ""))
    else:
        what = f"{row['branch']}.{row['operation']}: {verdict['decision']}"
        result = (verdict.get("reason") or {}).get("text", "")
    by_itself = (row.get("source") or "").startswith(ACTIVITY)
    kind, who = ("activity", "") if by_itself else (row["kind"], row.get("user") or "")
    return Entry(sequence, row["wall"], kind, row["session_id"], who, what, result)
