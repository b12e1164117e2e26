"""The session: whose it is, and what was decided and reported, newest first, with a filter."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from nicegui import ui

from pcmrs.console.cell_view_model import CellViewModel
from pcmrs.console.feed import Feed
from pcmrs.console.history import HISTORIANS, KINDS, Entry, heard_only, matching
from pcmrs.console.texts import Texts
from pcmrs.errors import PcmrsError
from pcmrs.messages.setup import Setup

ROWS = 100
"""So many of those that the filter lets through are shown."""
AT_FIRST = [kind for kind in KINDS if kind != "activity"]
COLUMNS = {"time": "nowrap", "who": "nowrap", "what": "normal", "result": "normal"}


class TimelinePanel:
    """A table of the journal, or for whoever may not read it, of what was heard.

    Args:
        feed: What the cell tells.
        told: What is shown: the feed, or a recording, whose own decisions and events these are then.
        setup: Of the cell.
        texts: Of the page's language.
    """

    def __init__(self, feed: Feed, told: CellViewModel, setup: Setup, texts: Texts) -> None:
        self._feed, self._told = feed, told
        self._may_read = setup.role in HISTORIANS and told is feed
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
            self._earlier = ui.button(texts("earlier"), on_click=self._reach_back).props("flat no-caps")
            self._earlier.props('data-testid="earlier"')
        columns = [
            {"name": name, "label": texts(name), "field": name, "align": "left", "style": f"white-space: {space}"}
            for name, space in COLUMNS.items()
        ]
        self._table = ui.table(columns=columns, rows=[], row_key="number").classes("w-full").props("dense flat")
        self._table.props('data-testid="timeline"')

    def refresh(self) -> None:
        """Show what has been added, or what the filter lets through now."""
        history = self._feed.history
        self._earlier.set_visibility(self._may_read and not history.whole)
        entries = history.entries if self._may_read else heard_only(self._told.events)
        rows = _rows(matching(reversed(entries), self._text.value or "", self._kinds.value or (), ROWS))
        if rows != self._table.rows:
            self._table.rows = rows

    async def _reach_back(self) -> None:
        if self._feed.client is None:
            return
        try:
            await self._feed.history.reach_back(self._feed.client)
        except PcmrsError as error:
            ui.notify(error.text, type="warning", position="bottom-left")
        self.refresh()


def _rows(entries: Iterable[Entry]) -> list[dict[str, object]]:
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
