"""The tool's pose: by a click, by keys, by numbers, or over a target in the cortex."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from pcmrs.console.planning.draft import Draft, typed_numbers, typed_point
from pcmrs.console.planning.editing import Editing, in_mm
from pcmrs.spatial import Floats

NUDGES = {
    "ArrowLeft": "arrow_back", "ArrowRight": "arrow_forward", "ArrowUp": "arrow_upward", "ArrowDown": "arrow_downward",
    "[": "rotate_left", "]": "rotate_right",
}  # fmt: skip
"""The keys that move the tool, and icons of buttons that do the same."""


class ToolForm:
    """Where the tool stands, and how to bring it elsewhere.

    Args:
        editing: The draft.
        cortex: Whether targets may lie in a cortex.
    """

    def __init__(self, editing: Editing, *, cortex: bool) -> None:
        self._editing = editing
        texts, draft = editing.texts, editing.draft
        ui.label(texts("click_tool")).classes("text-grey-8")
        with ui.row().classes("items-center gap-1"):
            self._point = editing.field("point", "tool-point")
            editing.button("place", "place-tool", lambda: self.pick(typed_point(self._point.value)))
            for key, icon in NUDGES.items():
                button = ui.button(icon=icon, on_click=partial(editing.do, partial(draft.move, key)))
                button.props("flat dense").props(f'data-testid="nudge-{key}" aria-label="{key}"')
        if cortex:
            self._target_row()
        self._shown = ui.label().props('data-testid="tool-pose"')

    def _target_row(self) -> None:
        editing, texts = self._editing, self._editing.texts
        with ui.row().classes("items-center gap-1"):
            self._target = editing.field("target_point", "target-point")
            self._way = ui.toggle({"closest": texts("closest"), "normal": texts("along_normal")}, value="closest")
            self._way.props("dense no-caps size=sm").props('data-testid="target-way"')
            self._normal = editing.field("normal", "target-normal").bind_visibility_from(
                self._way, "value", value="normal"
            )
            editing.button("project", "project-target", self._aim)

    def _aim(self) -> None:
        draft, target = self._editing.draft, typed_point(self._target.value)
        draft.aim(target, self._direction(draft, target) if self._way.value == "normal" else None)

    def _direction(self, draft: Draft, target: Floats) -> Floats:
        """As written down, or of the cortex."""
        return typed_numbers(self._normal.value) if self._normal.value else draft.normal_at(target)

    def pick(self, point: Floats) -> None:
        """Stands the tool at a point of the surface. Raises `GeometryError`."""
        self._editing.draft.place(point)

    def refresh(self) -> None:
        """Shows the draft."""
        draft, texts = self._editing.draft, self._editing.texts
        if draft.pose is None:
            self._shown.set_text("")
            return
        depth = draft.depth
        below = "" if depth is None else "   " + texts("depth", mm=1000.0 * depth)
        self._shown.set_text(in_mm(draft.pose.translation) + below)
