"""The tab of signals."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console.signals._health_panel import HealthPanel
from pcmrs.console.signals._motion import MotionPanel
from pcmrs.console.signals._muscle import MusclePanel
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup

PERIOD = 0.25
"""Period of storing moments, s."""
DRAW_PERIOD = 1.0
"""Period of drawing, s: charts are much work for a browser."""


class SignalsPanel:
    """Motion, muscle and the daemon's health; only drawn while the tab is open.

    Args:
        view: State of the cell to show: the feed, or a recording.
        setup: Setup of the cell.
        texts: Texts in the language of the page.
        is_open: Returns true while the tab is open.
    """

    def __init__(self, view: CellViewModel, setup: Setup, texts: Texts, is_open: Callable[[], bool]) -> None:
        self._view, self._is_open = view, is_open
        self._motion = MotionPanel(view, setup, texts)
        self._muscle = MusclePanel(view, setup, texts)
        self._health = HealthPanel(texts)
        ui.timer(PERIOD, self._motion.look)
        ui.timer(DRAW_PERIOD, self._draw)

    def _draw(self) -> None:
        if self._is_open():
            self._motion.draw()
            self._muscle.draw()
            self._health.draw(self._view.health)
