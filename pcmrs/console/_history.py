"""The journal for the page: read backwards from its end, a page of rows at a time, and then followed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

from pcmrs.client import Client
from pcmrs.messages import JournalQuery, Verdict
from pcmrs.messages.device import DeviceEvent
from pcmrs.messages.identity import Role

JOURNAL_READERS: tuple[Role, ...] = ("operator", "viewer")
"""Roles that may read the journal."""
PAGE = 200
"""Rows per request."""
AT_FIRST = 2000
"""Entries of a longer session that are read before the user asks for more."""
NEWEST = 2**62
"""Larger than the sequence of any row."""
KINDS = {
    "outcome": "kind_outcome",
    "device": "kind_device",
    "event": "kind_event",
    "config": "kind_config",
    "activity": "kind_activity",
}
"""Kinds of entries, and the text for each. Rows of other kinds are not shown: an intent has its outcome, a
snapshot the decision before it."""
ACTIVITY = "activity:"
"""Prefix of the source of activities, which nobody has asked for and which run all the time."""


@dataclass(frozen=True, slots=True)
class HistoryEntry:
    """One row of the journal, in words.

    Attributes:
        sequence: Sequence number of the row.
        wall: Wall time, Unix s.
        session: Identity of the session.
        who: User who asked; empty if nobody did.
        what: The operation with its decision, or the event.
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
    """The part of the journal that has been read.

    Attributes:
        entries: Entries, oldest first.
        whole: No row is before the oldest.
    """

    def __init__(self) -> None:
        self.entries: deque[HistoryEntry] = deque()
        self.whole = False
        self._first, self._last = NEWEST, 0

    async def follow(self, client: Client) -> None:
        """Read new rows; the first time, the session so far.

        Raises:
            UnknownOutcomeError: The daemon did not answer.
        """
        if not self._last:
            await self.read_older(client)
            while self._within_a_session() and not self.whole and len(self.entries) < AT_FIRST:
                await self.read_older(client)
            return
        rows: list[dict[str, Any]] = [{}]
        while rows:
            rows = (await client.journal(JournalQuery(after=self._last, limit=PAGE))).rows
            self.entries.extend(_entries(rows))
            self._last = max([self._last, *(row["sequence"] for row in rows)])

    async def read_older(self, client: Client) -> None:
        """Read the page before the rows that were read.

        Raises:
            UnknownOutcomeError: The daemon did not answer.
        """
        rows = (await client.journal(JournalQuery(before=self._first, limit=PAGE))).rows
        self.entries.extendleft(reversed(list(_entries(rows))))
        sequences = [row["sequence"] for row in rows]
        self._first, self._last = min([self._first, *sequences]), max([self._last, *sequences])
        self.whole = not rows or self._first == 1  # a page of long rows is shorter

    def _within_a_session(self) -> bool:
        return not self.entries or self.entries[0].session == self.entries[-1].session


def entries_from_events(events: Iterable[tuple[float, Verdict | DeviceEvent]]) -> list[HistoryEntry]:
    """Return received events as entries, in the same order, for users who may not read the journal."""
    return [
        HistoryEntry(
            number, wall, "outcome" if isinstance(event, Verdict) else "device", "", "", heading(event), why(event)
        )
        for number, (wall, event) in enumerate(events)
    ]


def matching(entries: Iterable[HistoryEntry], text: str, kinds: Iterable[str], most: int) -> list[HistoryEntry]:
    """Return the first entries that match a filter.

    Args:
        entries: All entries.
        text: Text that they contain, in upper or lower case.
        kinds: Kinds of entries; none for all kinds.
        most: Largest number of entries.
    """
    wanted, words = set(kinds), text.casefold()
    found = (
        each
        for each in entries
        if (not wanted or each.kind in wanted) and words in f"{each.who} {each.what} {each.result}".casefold()
    )
    return list(islice(found, most))


def heading(event: Verdict | DeviceEvent) -> str:
    """Return the decision or report in a few words."""
    if isinstance(event, Verdict):
        return f"{event.branch}.{event.operation}: {event.decision}"
    return f"{event.device}: {event.code}"


def why(event: Verdict | DeviceEvent) -> str:
    """Return the text that goes with it: its reason, or what a placement counts by; empty if there is none."""
    if isinstance(event, DeviceEvent):
        return event.text
    return _tolerance(event.result) if event.reason is None else event.reason.text


def _tolerance(result: Mapping[str, Any] | None) -> str:
    """Return the tracker's noise and the errors that count because of it, if a result has them."""
    return str(((result or {}).get("tolerance") or {}).get("text", ""))


def _entries(rows: Iterable[dict[str, Any]]) -> Iterator[HistoryEntry]:
    for store_upload in rows:
        row = store_upload["row"]
        if row["kind"] in KINDS:
            yield _entry(store_upload["sequence"], row)


def _entry(sequence: int, row: dict[str, Any]) -> HistoryEntry:
    verdict = row.get("verdict")
    if verdict is None:
        what, result = f"{row['source']}: {row['operation']}", str((row.get("result") or {}).get("text", ""))
    else:
        what = f"{row['branch']}.{row['operation']}: {verdict['decision']}"
        result = (verdict.get("reason") or {}).get("text", "") or _tolerance(verdict.get("result"))
    by_itself = (row.get("source") or "").startswith(ACTIVITY)
    kind, who = ("activity", "") if by_itself else (row["kind"], row.get("user") or "")
    return HistoryEntry(sequence, row["wall"], kind, row["session_id"], who, what, result)
