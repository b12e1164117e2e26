"""The tab of signals."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from pcmrs.console.feed import Feed
from pcmrs.console.signals.motion import MotionPanel
from pcmrs.console.signals.muscle import MusclePanel
from pcmrs.console.signals.wellbeing import WellbeingPanel
from pcmrs.console.texts import Texts
from pcmrs.console.told import Told
from pcmrs.messages.setup import Setup

PERIOD = 0.25
"""Between two looks, s."""
DRAWN = 1.0
"""Between two drawings: charts are much work for a browser, s."""


class SignalsPanel:
    """Motion, muscle and the daemon's health; only drawn while it is looked at.

    Args:
        feed: Of the cell.
        told: What is shown: the feed, or a recording.
        setup: Of the cell.
        texts: Of the page's language.
        is_open: Whether the tab is looked at.
    """

    def __init__(self, feed: Feed, told: Told, setup: Setup, texts: Texts, is_open: Callable[[], bool]) -> None:
        self._feed, self._told, self._is_open = feed, told, is_open
        self._motion = MotionPanel(told, texts)
        self._muscle = MusclePanel(told, setup, texts)
        self._health = WellbeingPanel(texts)
        ui.timer(PERIOD, self._look)
        ui.timer(DRAWN, self._draw)

    def _look(self) -> None:
        self._motion.look()
        self._muscle.look()

    def _draw(self) -> None:
        if self._is_open():
            self._motion.draw()
            self._muscle.draw()
            self._health.draw(self._feed.health if self._told is self._feed else None)
