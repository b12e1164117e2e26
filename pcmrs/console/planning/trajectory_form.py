"""A trajectory into the bone: where the drill enters, and where it is to end."""

from __future__ import annotations

import numpy as np
from nicegui import ui

from pcmrs.console.planning.draft import typed_point
from pcmrs.console.planning.editing import Editing, in_mm
from pcmrs.spatial import Floats


class TrajectoryForm:
    """Two points, by clicks or numbers.

    Args:
        editing: The draft.
    """

    def __init__(self, editing: Editing) -> None:
        self._editing = editing
        texts = editing.texts
        ui.label(texts("click_trajectory")).classes("text-grey-8")
        self._which = ui.toggle({"entry": texts("entry"), "end": texts("end")}, value="entry")
        self._which.props("dense no-caps size=sm").props('data-testid="trajectory-which"')
        with ui.row().classes("items-center gap-1"):
            self._point = editing.field("point", "trajectory-point")
            editing.button("place", "place-trajectory", lambda: self.pick(typed_point(self._point.value)))
        self._shown = ui.label().props('data-testid="trajectory"')

    def pick(self, point: Floats) -> None:
        """Takes a point as entry or end, whichever is chosen; after an entry comes the end."""
        if self._which.value == "entry":
            self._editing.draft.entry = point
            self._which.set_value("end")
        else:
            self._editing.draft.end = point

    def refresh(self) -> None:
        """Shows the draft."""
        draft, texts = self._editing.draft, self._editing.texts
        named = {texts("entry"): draft.entry, texts("end"): draft.end}
        parts = [f"{name}: {in_mm(point)}" for name, point in named.items() if point is not None]
        if draft.entry is not None and draft.end is not None:
            parts.append(texts("length", mm=1000.0 * float(np.linalg.norm(draft.entry - draft.end))))
        self._shown.set_text("   ".join(parts))
