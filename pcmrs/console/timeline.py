"""The session: whose it is, and what was decided and reported, newest first, with a filter."""

from __future__ import annotations

from datetime import datetime

from nicegui import ui

from pcmrs.console.feed import Feed
from pcmrs.console.texts import Texts
from pcmrs.console.workflow import heading, why
from pcmrs.messages.setup import Setup


class TimelinePanel:
    """A table.

    Args:
        feed: What the cell tells.
        setup: Of the cell.
        texts: Of the page's language.
    """

    def __init__(self, feed: Feed, setup: Setup, texts: Texts) -> None:
        self._feed, self._texts = feed, texts
        ui.label(f"{texts('patient')}: {setup.patient or texts('unknown')}").props('data-testid="patient"')
        ui.label(f"{texts('operator')}: {setup.operator or texts('unknown')}")
        wanted = ui.input(texts("filter")).props("dense clearable").props('data-testid="filter"')
        columns = [
            {"name": name, "label": texts(name), "field": name, "align": "left", "style": "white-space: normal"}
            for name in ("time", "what", "result")
        ]
        self._table = ui.table(columns=columns, rows=[], row_key="number").classes("w-full").props("dense flat")
        self._table.bind_filter_from(wanted, "value").props('data-testid="timeline"')

    def refresh(self) -> None:
        """Shows what has been added."""
        self._table.rows = [
            {
                "number": number,
                "time": datetime.fromtimestamp(at).strftime("%H:%M:%S"),
                "what": heading(event, self._texts),
                "result": why(event),
            }
            for number, (at, event) in reversed(list(enumerate(self._feed.events)))
        ]
        self._table.update()
