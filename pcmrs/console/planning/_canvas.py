"""The image in three dimensions: the surface, and the plan on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from nicegui import events, ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console._scene import BACKGROUND, PLANNED, SKIN, SURFACE, fit, ignore_drags, show, tool
from pcmrs.console.planning._draft import Draft
from pcmrs.messages.setup import Setup
from pcmrs.spatial import Floats, Transform

LANDMARK, POINT, TARGET, CORTEX = "#cc79a7", "#0072b2", "#d55e00", "#b0b7bf"
BALL = 0.004
"""Radius of a point, m."""


class Canvas:
    """Scene of the planning.

    Args:
        setup: Setup of the cell.
        pick: Called with a point of the surface that was clicked, m, (3,).
    """

    def __init__(self, setup: Setup, pick: Callable[[Floats], None]) -> None:
        self._pick = pick
        self._balls: list[Object3D] = []
        self._surface: Object3D | None = None
        self._cortex: Object3D | None = None
        with ui.scene(width=10, height=10, grid=False, on_click=self._click, background_color=BACKGROUND) as scene:
            self._scene = scene.classes("w-full").style("height: 300px").props('data-testid="planning"')
            self._tool = tool(scene, setup, PLANNED, 0.6)
        fit(scene)
        ignore_drags(scene)
        scene.move_camera(0.06, 0.26, 0.12, 0.004, 0.0, 0.03, duration=0.0)
        if setup.surface is not None:
            self.show_surface(SURFACE)

    def show_surface(self, url: str | None) -> None:
        """Show the STL at an address as the surface; None shows none."""
        if self._surface is not None:
            self._surface.delete()
        with self._scene:
            self._surface = None if url is None else self._scene.stl(url).material(SKIN, 1.0).with_name("surface")

    def show_cortex(self, url: str) -> None:
        """Show the STL at an address as the cortex, and make the surface transparent."""
        if self._cortex is not None:
            self._cortex.delete()
        with self._scene:
            self._cortex = self._scene.stl(url).material(CORTEX, 1.0).with_name("cortex")
        if self._surface is not None:
            self._surface.material(SKIN, 0.4)

    def look_at(self, vertices: npt.NDArray[np.float64]) -> None:
        """Bring vertices, m, (V, 3), into view, from the front and above."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        (x, y, z), size = (low + high) / 2.0, float((high - low).max())
        self._scene.move_camera(x + 0.3 * size, y + 1.1 * size, z + 0.5 * size, x, y, z, duration=0.0)

    def draw(self, draft: Draft, pose: Transform | None) -> None:
        """Show a draft, and the tool at a pose.

        Args:
            draft: The draft.
            pose: ``image_from_coil`` of the tool; None hides it.
        """
        for ball in self._balls:
            ball.delete()
        points = [(np.array(each.planned), LANDMARK, f"landmark {each.name}") for each in draft.landmarks]
        points += [(each.translation, POINT, f"grid {number}") for number, each in enumerate(draft.grid, start=1)]
        named = (("target", draft.target), ("entry", draft.entry), ("end", draft.end))
        points += [(point, TARGET, name) for name, point in named if point is not None]
        with self._scene:
            self._balls = [self._ball(point, colour).with_name(name) for point, colour, name in points]
            if draft.entry is not None and draft.end is not None:
                line = self._scene.line(draft.entry.tolist(), draft.end.tolist()).material(TARGET)
                self._balls.append(line.with_name("trajectory"))
        show(self._tool, pose)

    def _ball(self, point: Floats, colour: str) -> Object3D:
        x, y, z = np.round(point, 5).tolist()
        return self._scene.sphere(BALL).material(colour).move(x, y, z)

    def _click(self, event: events.SceneClickEventArguments) -> None:
        hit = next((each for each in event.hits if each.object_name == "surface"), None)
        if hit is not None:
            self._pick(np.array((hit.x, hit.y, hit.z)))
