"""Forms of the planning: landmarks, tool pose, trajectory and grid.

Landmarks: by a click, or by name and numbers.

The tool's pose: by a click, by keys, by numbers, or over a target in the cortex.

A trajectory into the bone: where the drill enters, and where it is to end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from nicegui import ui

from pcmrs.console.planning._draft import Draft, typed_numbers, typed_point
from pcmrs.console.texts import Texts
from pcmrs.errors import GeometryError, PcmrsError
from pcmrs.spatial import Floats
from pcmrs.tms.grid import MAX_ROWS


@dataclass(frozen=True)
class DraftEditor:
    """The draft of one page, and its widgets.

    Attributes:
        draft: The plan.
        texts: Texts in the language of the page.
        changed: Called when the draft has changed.
    """

    draft: Draft
    texts: Texts
    changed: Callable[[], None]

    def do(self, action: Callable[[], object]) -> None:
        """Change the draft; a refusal is shown, and leaves it unchanged."""
        try:
            action()
        except PcmrsError as error:
            ui.notify(error.text, type="negative", multi_line=True, position="bottom-left")
            return
        self.changed()

    def field(self, label: str, name: str, value: str = "") -> ui.input:
        """Return a short text field.

        Args:
            label: Key of its label.
            name: Its ``data-testid``.
            value: Its first content.
        """
        return ui.input(self.texts(label), value=value).props("dense").classes("w-36").props(f'data-testid="{name}"')

    def button(self, label: str, name: str, action: Callable[[], object]) -> ui.button:
        """Return a button that changes the draft.

        Args:
            label: Key of its label.
            name: Its ``data-testid``.
            action: Changes the draft.
        """
        button = ui.button(self.texts(label), on_click=lambda: self.do(action)).props("dense flat no-caps")
        return button.props(f'data-testid="{name}"')


def _in_mm(point: npt.ArrayLike) -> str:
    """Return a point, m, (3,), as text in mm."""
    x, y, z = 1000.0 * np.asarray(point, dtype=float)
    return f"{x:.1f} {y:.1f} {z:.1f} mm"


class LandmarkForm:
    """The list of landmarks, and a row to add one.

    Args:
        editor: Editor of the draft.
    """

    def __init__(self, editor: DraftEditor) -> None:
        self._editor = editor
        ui.label(editor.texts("click_landmark")).classes("text-grey-8")
        self._list = ui.column().classes("w-full gap-0").props('data-testid="landmarks"')
        with ui.row().classes("items-center gap-1"):
            self._name = editor.field("landmark_name", "landmark-name")
            self._point = editor.field("point", "landmark-point")
            editor.button("add", "add-landmark", lambda: self.pick(typed_point(self._point.value)))
            editor.button("clear", "clear-landmarks", lambda: editor.draft.landmarks.clear())

    def pick(self, point: Floats) -> None:
        """Add a landmark with the typed name.

        Raises:
            GeometryError: The name is used already.
        """
        self._editor.draft.add_landmark(point, self._name.value or "")
        self._name.set_value("")

    def refresh(self) -> None:
        """Show the draft."""
        self._list.clear()
        with self._list:
            for each in self._editor.draft.landmarks:
                ui.label(f"{each.name}: {_in_mm(each.planned)}")


NUDGES = {
    "ArrowLeft": "arrow_back", "ArrowRight": "arrow_forward", "ArrowUp": "arrow_upward", "ArrowDown": "arrow_downward",
    "[": "rotate_left", "]": "rotate_right",
}  # fmt: skip
"""Keys that move the tool, and the icons of the corresponding buttons."""


class ToolForm:
    """The pose of the tool, and ways to change it.

    Args:
        editor: Editor of the draft.
        cortex: Targets may be in a cortex.
    """

    def __init__(self, editor: DraftEditor, *, cortex: bool) -> None:
        self._editor = editor
        texts, draft = editor.texts, editor.draft
        ui.label(texts("click_tool")).classes("text-grey-8")
        with ui.row().classes("items-center gap-1"):
            self._point = editor.field("point", "tool-point")
            editor.button("place", "place-tool", lambda: self.pick(typed_point(self._point.value)))
            for key, icon in NUDGES.items():
                button = ui.button(icon=icon, on_click=partial(editor.do, partial(draft.move, key)))
                button.props("flat dense").props(f'data-testid="nudge-{key}" aria-label="{key}"')
        if cortex:
            self._target_row()
        self._shown = ui.label().props('data-testid="tool-pose"')

    def _target_row(self) -> None:
        editor, texts = self._editor, self._editor.texts
        with ui.row().classes("items-center gap-1"):
            self._target = editor.field("target_point", "target-point")
            self._way = ui.toggle({"closest": texts("closest"), "normal": texts("along_normal")}, value="closest")
            self._way.props("dense no-caps size=sm").props('data-testid="target-way"')
            self._normal = editor.field("normal", "target-normal").bind_visibility_from(
                self._way, "value", value="normal"
            )
            editor.button("project", "project-target", self._aim)

    def _aim(self) -> None:
        draft, target = self._editor.draft, typed_point(self._target.value)
        draft.aim(target, self._direction(draft, target) if self._way.value == "normal" else None)

    def _direction(self, draft: Draft, target: Floats) -> Floats:
        """Return the typed direction, or that of the cortex."""
        return typed_numbers(self._normal.value) if self._normal.value else draft.normal_at(target)

    def pick(self, point: Floats) -> None:
        """Place the tool at a point of the surface.

        Raises:
            GeometryError: There is no surface.
        """
        self._editor.draft.place(point)

    def refresh(self) -> None:
        """Show the draft."""
        draft, texts = self._editor.draft, self._editor.texts
        if draft.pose is None:
            self._shown.set_text("")
            return
        depth = draft.depth
        below = "" if depth is None else "   " + texts("depth", mm=1000.0 * depth)
        self._shown.set_text(_in_mm(draft.pose.translation) + below)


class TrajectoryForm:
    """Entry and end, by clicks or numbers.

    Args:
        editor: Editor of the draft.
    """

    def __init__(self, editor: DraftEditor) -> None:
        self._editor = editor
        texts = editor.texts
        ui.label(texts("click_trajectory")).classes("text-grey-8")
        self._which = ui.toggle({"entry": texts("entry"), "end": texts("end")}, value="entry")
        self._which.props("dense no-caps size=sm").props('data-testid="trajectory-which"')
        with ui.row().classes("items-center gap-1"):
            self._point = editor.field("point", "trajectory-point")
            editor.button("place", "place-trajectory", lambda: self.pick(typed_point(self._point.value)))
        self._shown = ui.label().props('data-testid="trajectory"')

    def pick(self, point: Floats) -> None:
        """Take a point as entry or end, whichever is chosen; after an entry, the end is chosen."""
        if self._which.value == "entry":
            self._editor.draft.entry = point
            self._which.set_value("end")
        else:
            self._editor.draft.end = point

    def refresh(self) -> None:
        """Show the draft."""
        draft, texts = self._editor.draft, self._editor.texts
        named = {texts("entry"): draft.entry, texts("end"): draft.end}
        parts = [f"{name}: {_in_mm(point)}" for name, point in named.items() if point is not None]
        if draft.entry is not None and draft.end is not None:
            parts.append(texts("length", mm=1000.0 * float(np.linalg.norm(draft.entry - draft.end))))
        self._shown.set_text("   ".join(parts))


class GridForm:
    """Spacing and size of the grid.

    Args:
        editor: Editor of the draft.
    """

    def __init__(self, editor: DraftEditor) -> None:
        self._editor = editor
        texts = editor.texts
        ui.label(texts("click_grid")).classes("text-grey-8")
        with ui.row().classes("items-center gap-1"):
            self._spacing = ui.number(texts("spacing"), value=10.0, min=1.0, max=50.0)
            self._rows = ui.number(texts("rows"), value=3, min=1, max=MAX_ROWS, precision=0)
            self._columns = ui.number(texts("columns"), value=3, min=1, max=MAX_ROWS, precision=0)
            for number, name in ((self._spacing, "spacing"), (self._rows, "rows"), (self._columns, "columns")):
                number.props("dense").classes("w-24").props(f'data-testid="grid-{name}"')
            editor.button("lay_grid", "lay-grid", self._lay)
        self._shown = ui.label().props('data-testid="grid"')

    def pick(self, point: Floats) -> None:
        """Place the grid around a point of the surface.

        Raises:
            GeometryError: The grid is not possible there, or its size is missing.
        """
        self._editor.draft.place(point)
        self._lay()

    def _lay(self) -> None:
        spacing, rows, columns = self._spacing.value, self._rows.value, self._columns.value
        if spacing is None or rows is None or columns is None:
            raise GeometryError("A grid needs spacing, rows and columns as numbers.")
        self._editor.draft.lay_grid(spacing / 1000.0, int(rows), int(columns))

    def refresh(self) -> None:
        """Show the draft."""
        self._shown.set_text(self._editor.texts("grid_points", count=len(self._editor.draft.grid)))
