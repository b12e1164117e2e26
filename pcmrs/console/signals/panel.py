"""The tab of signals."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from pcmrs.console.cell_view_model import CellViewModel
from pcmrs.console.signals.health_panel import WellbeingPanel
from pcmrs.console.signals.motion import MotionPanel
from pcmrs.console.signals.muscle import MusclePanel
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup

PERIOD = 0.25
"""Between two looks, s."""
DRAWN = 1.0
"""Between two drawings: charts are much work for a browser, s."""


class SignalsPanel:
    """Motion, muscle and the daemon's health; only drawn while it is looked at.

    Args:
        told: What is shown: the feed, or a recording.
        setup: Of the cell.
        texts: Of the page's language.
        is_open: Whether the tab is looked at.
    """

    def __init__(self, told: CellViewModel, setup: Setup, texts: Texts, is_open: Callable[[], bool]) -> None:
        self._told, self._is_open = told, is_open
        self._motion = MotionPanel(told, texts)
        self._muscle = MusclePanel(told, setup, texts)
        self._health = WellbeingPanel(texts)
        ui.timer(PERIOD, self._motion.look)
        ui.timer(DRAWN, self._draw)

    def _draw(self) -> None:
        if self._is_open():
            self._motion.draw()
            self._muscle.draw()
            self._health.draw(self._told.health)
