"""A grid of poses around the tool."""

from __future__ import annotations

from nicegui import ui

from pcmrs.console.planning.editing import Editing
from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats
from pcmrs.tms.grid import MAX_ROWS


class GridForm:
    """Spacing and size.

    Args:
        editing: The draft.
    """

    def __init__(self, editing: Editing) -> None:
        self._editing = editing
        texts = editing.texts
        ui.label(texts("click_grid")).classes("text-grey-8")
        with ui.row().classes("items-center gap-1"):
            self._spacing = ui.number(texts("spacing"), value=10.0, min=1.0, max=50.0)
            self._rows = ui.number(texts("rows"), value=3, min=1, max=MAX_ROWS, precision=0)
            self._columns = ui.number(texts("columns"), value=3, min=1, max=MAX_ROWS, precision=0)
            for number, name in ((self._spacing, "spacing"), (self._rows, "rows"), (self._columns, "columns")):
                number.props("dense").classes("w-24").props(f'data-testid="grid-{name}"')
            editing.button("lay_grid", "lay-grid", self._lay)
        self._shown = ui.label().props('data-testid="grid"')

    def pick(self, point: Floats) -> None:
        """Lays the grid around a point of the surface. Raises `GeometryError`."""
        self._editing.draft.place(point)
        self._lay()

    def _lay(self) -> None:
        spacing, rows, columns = self._spacing.value, self._rows.value, self._columns.value
        if spacing is None or rows is None or columns is None:
            raise GeometryError("A grid needs spacing, rows and columns as numbers.")
        self._editing.draft.lay_grid(spacing / 1000.0, int(rows), int(columns))

    def refresh(self) -> None:
        """Shows the draft."""
        self._shown.set_text(self._editing.texts("grid_points", count=len(self._editing.draft.grid)))
