"""The session: its patient and operator, and its decisions and reports, newest first, with a filter."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from nicegui import ui

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._history import JOURNAL_READERS, KINDS, HistoryEntry, entries_from_events, matching
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console.texts import Texts
from pcmrs.errors import PcmrsError
from pcmrs.messages.setup import Setup

ROWS = 100
"""Largest number of rows that are shown."""
AT_FIRST = [kind for kind in KINDS if kind != "activity"]
COLUMNS = {"time": "nowrap", "who": "nowrap", "what": "normal", "result": "normal"}


class TimelinePanel:
    """Table of the journal or, for users who may not read it, of the received events.

    Args:
        feed: State of the cell.
        view: State to show: the feed, or a recording, which has its own decisions and events.
        setup: Setup of the cell.
        texts: Texts in the language of the page.
    """

    def __init__(self, feed: LiveFeed, view: CellViewModel, setup: Setup, texts: Texts) -> None:
        self._feed, self._view = feed, view
        self._may_read = setup.role in JOURNAL_READERS and view is feed
        ui.label(f"{texts('patient')}: {setup.patient or texts('unknown')}").props('data-testid="patient"')
        ui.label(f"{texts('operator')}: {setup.operator or texts('unknown')}")
        if not self._may_read:
            ui.label(texts("heard_only")).classes("text-grey-8")
        with ui.row().classes("items-center w-full no-wrap"):
            self._text = ui.input(texts("filter"), on_change=self.refresh).props("dense clearable").classes("col-grow")
            self._text.props('data-testid="filter"')
            names = {kind: texts(key) for kind, key in KINDS.items()}
            self._kinds = ui.select(names, label=texts("kinds"), multiple=True, on_change=self.refresh, value=AT_FIRST)
            self._kinds.props('dense clearable data-testid="kinds"').classes("w-40")
            self._earlier = ui.button(texts("earlier"), on_click=self._load_earlier).props("flat no-caps")
            self._earlier.props('data-testid="earlier"')
        columns = [
            {"name": name, "label": texts(name), "field": name, "align": "left", "style": f"white-space: {space}"}
            for name, space in COLUMNS.items()
        ]
        self._table = ui.table(columns=columns, rows=[], row_key="number").classes("w-full").props("dense flat")
        self._table.props('data-testid="timeline"')

    def refresh(self) -> None:
        """Show new entries, or those that match a new filter."""
        history = self._feed.history
        self._earlier.set_visibility(self._may_read and not history.whole)
        entries = history.entries if self._may_read else entries_from_events(self._view.events)
        rows = _rows(matching(reversed(entries), self._text.value or "", self._kinds.value or (), ROWS))
        if rows != self._table.rows:
            self._table.rows = rows

    async def _load_earlier(self) -> None:
        if self._feed.client is None:
            return
        try:
            await self._feed.history.read_older(self._feed.client)
        except PcmrsError as error:
            ui.notify(error.text, type="warning", position="bottom-left")
        self.refresh()


def _rows(entries: Iterable[HistoryEntry]) -> list[dict[str, object]]:
    return [
        {
            "number": each.sequence,
            "time": datetime.fromtimestamp(each.wall).strftime("%Y-%m-%d %H:%M:%S"),
            "who": each.who,
            "what": each.what,
            "result": each.result,
        }
        for each in entries
    ]
