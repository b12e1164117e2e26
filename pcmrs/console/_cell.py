"""The cell in three dimensions: arm, tool, tracker, body, forbidden zones; planned green, measured red."""

from __future__ import annotations

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console._body import BodyView
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._geometry import TrackerLocator, along, tool_tip
from pcmrs.console._residuals import gradient
from pcmrs.console._scene import ARM, BACKGROUND, BOX, MEASURED, PLANNED, fit, put, show, tool
from pcmrs.console._surfaces import Surfaces
from pcmrs.console._tracking import TrackingView, VisibilityRow
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.data import as_transform

RATE = 30.0
"""Updates per second."""


class CellPanel:
    """Scene of the cell, updated while its page is open.

    Args:
        view: State of the cell to show.
        setup: Setup of the cell.
        texts: Texts in the language of the page.
        surfaces: Served surfaces of the body.
    """

    def __init__(self, view: CellViewModel, setup: Setup, texts: Texts, surfaces: Surfaces) -> None:
        self._view, self._setup = view, setup
        self._locator = TrackerLocator(setup)
        with ui.element("div").classes("relative w-full h-full"):
            # The browser waits for its next frame and then for 1/fps: only this value makes it draw RATE of them.
            with ui.scene(width=10, height=10, grid=False, fps=int(2 * RATE), background_color=BACKGROUND) as scene:
                self.scene = scene.classes("w-full h-full").props('aria-label="Scene"')
                self._links = [self._link(span) for span in self._locator.arm.spans]
                self._boxes = [self._box(name, size, pose) for name, size, pose in _boxes(setup)]
                self._planned = tool(scene, setup, PLANNED, 0.55).with_name("planned").visible(False)
                self._measured = tool(scene, setup, MEASURED, 0.85).with_name("measured").visible(False)
            self._tracking = TrackingView(scene, setup)
            self._body = BodyView(scene, view, setup, surfaces)
            with ui.column().classes("absolute top-2 left-2 gap-0"):
                self._seen = VisibilityRow(texts)
            with ui.row().classes("absolute bottom-0 left-2 items-center gap-2 w-full"):
                self._wanted = {name: ui.checkbox(texts(name), value=True) for name in ("zones", "tracker")}
                self._error = ui.checkbox(texts("predicted_error")).props('data-testid="predicted-error"')
                self._legend(texts)
        fit(scene)
        scene.move_camera(1.3, 1.0, 0.85, 0.4, 0.0, 0.3, duration=0.0)
        ui.timer(1.0 / RATE, self._follow)
        ui.timer(0.5, self._colour)

    def _legend(self, texts: Texts) -> None:
        """Add the legend of the predicted error, which is visible while the error is shown."""
        with ui.row().classes("items-center gap-1 no-wrap text-caption").bind_visibility_from(self._error, "value"):
            ui.label("0")
            ui.element("div").style(f"width: 90px; height: 12px; background: {gradient()}")
            limit = texts("error_scale", mm=1000.0 * self._setup.tre_limit)
            ui.label(limit).props('data-testid="legend"')

    def _link(self, span: Floats) -> Object3D:
        """Return a group with a ball at a joint and a bar to the next."""
        radius = self._locator.arm.radius
        with self.scene.group() as group:
            self.scene.sphere(radius, 12, 8).material(ARM)
            length = float(np.linalg.norm(span))
            if length > 1e-3:
                bar = self.scene.cylinder(0.8 * radius, 0.8 * radius, length, 16).material(ARM)
                put(bar, Transform(along(span / length), span / 2.0))
        return group.with_name("link")

    def _box(self, name: str, size: tuple[float, float, float], pose: Transform) -> Object3D:
        shape = self.scene.box(*size).material(BOX, 0.35).with_name(f"box {name}")
        put(shape, pose)
        return shape

    def _follow(self) -> None:
        view = self._view
        self._seen.follow(view)
        if view.joints is None:
            return
        measured, body_ref = tool_tip(self._setup, view.poses.get("coil")), view.poses.get("body_ref")
        frames = self._locator.see(view.joints.positions, measured, moving=view.joints.moving)
        for link, frame in zip(self._links, frames, strict=False):
            put(link, frame)
        for box in self._boxes:
            box.visible(self._wanted["zones"].value)
        self._tracking.follow(view, self._locator, wanted=self._wanted["tracker"].value)
        base_from_tracker = self._locator.base_from_tracker
        show(self._measured, None if measured is None or base_from_tracker is None else base_from_tracker @ measured)
        image = self._body.follow(self._locator.in_base(body_ref), zone=self._wanted["zones"].value)
        plan = view.data.plan
        show(self._planned, None if image is None or plan is None else image @ as_transform(plan))

    async def _colour(self) -> None:
        await self._body.colour(wanted=self._error.value)


def _boxes(setup: Setup) -> list[tuple[str, tuple[float, float, float], Transform]]:
    return [(each.name, each.size, as_transform(each.pose)) for each in setup.boxes]
