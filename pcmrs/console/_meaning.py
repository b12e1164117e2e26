"""Buttons whose meaning changes under the finger: what was pressed too soon after that is ignored. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

SETTLING_TIME: Final = 0.7
"""Time for which a button ignores presses after its meaning has changed, s: longer than the pause in a double click."""


class ButtonMeaning:
    """Meaning of one button, with the time since which it is shown.

    Args:
        now: Returns the present time, s of a steady clock.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._shown = ""
        self._since = now()

    def show(self, meaning: str) -> None:
        """Note what the button means from now on.

        Args:
            meaning: Name of what a press does; empty if it does nothing.
        """
        if meaning != self._shown:
            self._shown, self._since = meaning, self._now()

    def accepts(self, meaning: str) -> bool:
        """Return true if a person who presses the button now can mean this.

        Args:
            meaning: Name of what a press would do.
        """
        return bool(meaning) and meaning == self._shown and self._now() - self._since >= SETTLING_TIME
