"""What the forms share: the draft, the words, and what happens when something is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from nicegui import ui

from pcmrs.console.planning.draft import Draft
from pcmrs.console.texts import Texts
from pcmrs.errors import PcmrsError


@dataclass(frozen=True)
class Editing:
    """One per page.

    Attributes:
        draft: What is planned.
        texts: Of the page's language.
        changed: Called when the draft has changed.
    """

    draft: Draft
    texts: Texts
    changed: Callable[[], None]

    def do(self, action: Callable[[], object]) -> None:
        """Changes the draft; a refusal is told, and leaves it as it was."""
        try:
            action()
        except PcmrsError as error:
            ui.notify(error.text, type="negative", multi_line=True, position="bottom-left")
            return
        self.changed()

    def field(self, label: str, name: str, value: str = "") -> ui.input:
        """A short field of text, known to tests as `name`."""
        return ui.input(self.texts(label), value=value).props("dense").classes("w-36").props(f'data-testid="{name}"')

    def button(self, label: str, name: str, action: Callable[[], object]) -> ui.button:
        """A button that changes the draft, known to tests as `name`."""
        button = ui.button(self.texts(label), on_click=lambda: self.do(action)).props("dense flat no-caps")
        return button.props(f'data-testid="{name}"')


def in_mm(point: npt.ArrayLike) -> str:
    """A point, m, (3,), for people."""
    x, y, z = 1000.0 * np.asarray(point, dtype=float)
    return f"{x:.1f} {y:.1f} {z:.1f} mm"
