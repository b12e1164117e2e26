"""Landmarks: by a click, or by name and numbers."""

from __future__ import annotations

from nicegui import ui

from pcmrs.console.planning.draft import typed_point
from pcmrs.console.planning.editing import Editing, in_mm
from pcmrs.spatial import Floats


class LandmarkForm:
    """The list, and a row to add to it.

    Args:
        editing: The draft.
    """

    def __init__(self, editing: Editing) -> None:
        self._editing = editing
        ui.label(editing.texts("click_landmark")).classes("text-grey-8")
        self._list = ui.column().classes("w-full gap-0").props('data-testid="landmarks"')
        with ui.row().classes("items-center gap-1"):
            self._name = editing.field("landmark_name", "landmark-name")
            self._point = editing.field("point", "landmark-point")
            editing.button("add", "add-landmark", lambda: self.pick(typed_point(self._point.value)))
            editing.button("clear", "clear-landmarks", lambda: editing.draft.landmarks.clear())

    def pick(self, point: Floats) -> None:
        """Adds a landmark by the name that is written down. Raises `GeometryError`."""
        self._editing.draft.add_landmark(point, self._name.value or "")
        self._name.set_value("")

    def refresh(self) -> None:
        """Shows the draft."""
        self._list.clear()
        with self._list:
            for each in self._editing.draft.landmarks:
                ui.label(f"{each.name}: {in_mm(each.planned)}")
