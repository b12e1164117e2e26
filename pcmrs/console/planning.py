"""Planning on the body's surface: landmarks and the tool's pose, by a click, by keys, or by numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from nicegui import events, ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console.asking import Asking
from pcmrs.console.choices import Choice
from pcmrs.console.feed import Feed
from pcmrs.console.geometry import vertices_of
from pcmrs.console.scene import AXES, PLANNED, SKIN, SURFACE, put, show
from pcmrs.console.texts import Texts
from pcmrs.errors import GeometryError
from pcmrs.messages.setup import LandmarkShown, Setup
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import along_scalp, on_scalp, turned
from pcmrs.workflows.data import as_transform

STEP, TURN = 0.001, math.radians(5.0)
"""What a key moves the tool along the surface, m, or turns it about its axis, rad."""
MOVES = {"ArrowRight": (STEP, 0.0), "ArrowLeft": (-STEP, 0.0), "ArrowUp": (0.0, STEP), "ArrowDown": (0.0, -STEP)}
TURNS = {"[": TURN, "]": -TURN}
LANDMARK = "#cc79a7"

Mode = Literal["landmarks", "tool"]


class PlanningPanel:
    """A scene in the image's frame, and what is planned there but not yet sent.

    Args:
        feed: What the cell tells.
        setup: Of the cell.
        texts: Of the page's language.
        asking: Asks the daemon.
    """

    def __init__(self, feed: Feed, setup: Setup, texts: Texts, asking: Asking) -> None:
        self._feed, self._setup, self._texts, self._asking = feed, setup, texts, asking
        self._surface = None if setup.surface is None else TriangleSurface(*vertices_of(setup.surface))
        self._landmarks: list[LandmarkShown] = list(feed.data.landmarks)
        self._pose: Transform | None = None if feed.data.plan is None else as_transform(feed.data.plan)
        self._balls: list[Object3D] = []
        self._sending: dict[str, ui.button] = {}
        with ui.scene(width=10, height=10, grid=False, on_click=self._click, background_color="#f4f6f8") as scene:
            self._scene = scene.classes("w-full").style("height: 300px").props('data-testid="planning"')
            if setup.surface is not None:
                scene.stl(SURFACE).material(SKIN, 1.0).with_name("surface")
            with scene.group() as self._tool:
                disc = scene.cylinder(setup.tool_radius, setup.tool_radius, 2.0 * setup.tool_half_length, 48)
                put(disc.material(PLANNED, 0.6), Transform(AXES, np.array((0.0, 0.0, setup.tool_half_length))))
                handle = scene.box(0.02, 0.16, 0.02).material(PLANNED, 0.6)
                handle.move(0.0, -setup.tool_radius - 0.07, setup.tool_half_length)
        scene.move_camera(0.06, 0.26, 0.12, 0.004, 0.0, 0.03, duration=0.0)
        self._mode = ui.toggle(
            {"landmarks": texts("landmarks"), "tool": texts("tool")}, value="landmarks"
        ).props("dense no-caps").props('data-testid="mode"')  # fmt: skip
        self._landmark_form()
        self._tool_form()
        self._draw()

    def _landmark_form(self) -> None:
        texts = self._texts
        with ui.column().classes("w-full gap-1").bind_visibility_from(self._mode, "value", value="landmarks"):
            ui.label(texts("click_landmark")).classes("text-grey-8")
            self._list = ui.column().classes("w-full gap-0").props('data-testid="landmarks"')
            with ui.row().classes("items-center no-wrap"):
                self._name = (
                    ui.input(texts("landmark_name")).props("dense").classes("w-32").props('data-testid="landmark-name"')
                )
                self._point = (
                    ui.input(texts("point")).props("dense").classes("w-40").props('data-testid="landmark-point"')
                )
                ui.button(texts("add"), on_click=self._add_typed).props("dense flat no-caps").props(
                    'data-testid="add-landmark"'
                )
            with ui.row():
                self._sending["registration.plan_landmarks"] = (
                    ui.button(texts("send_landmarks"), on_click=self._send_landmarks)
                    .props("no-caps")
                    .props('data-testid="send-landmarks"')
                )
                ui.button(texts("clear"), on_click=self._clear).props("flat no-caps").props(
                    'data-testid="clear-landmarks"'
                )

    def _tool_form(self) -> None:
        texts = self._texts
        with ui.column().classes("w-full gap-1").bind_visibility_from(self._mode, "value", value="tool"):
            ui.label(texts("click_tool")).classes("text-grey-8")
            with ui.row().classes("items-center no-wrap"):
                self._where = ui.input(texts("point")).props("dense").classes("w-40").props('data-testid="tool-point"')
                ui.button(texts("add"), on_click=self._place_typed).props("dense flat no-caps").props(
                    'data-testid="place-tool"'
                )
            self._shown = ui.label().props('data-testid="tool-pose"')
            self._sending["toolplan.plan"] = (
                ui.button(texts("send_tool"), on_click=self._send_pose)
                .props("no-caps")
                .props('data-testid="send-tool"')
            )

    def refresh(self, choices: Mapping[str, Choice]) -> None:
        """Lets be sent what may be asked for."""
        for name, button in self._sending.items():
            button.set_enabled(name in choices and not choices[name].why_not)

    def key(self, key: str) -> None:
        """Moves the tool along the surface, or turns it; other keys do nothing."""
        if self._pose is None or self._mode.value != "tool":
            return
        try:
            if key in TURNS:
                self._pose = turned(self._pose, TURNS[key])
            elif key in MOVES and self._surface is not None:
                (self._pose,) = along_scalp(self._surface.closest, self._pose, [MOVES[key]])
        except GeometryError as error:
            ui.notify(error.text, type="negative")
        self._draw()

    def _click(self, event: events.SceneClickEventArguments) -> None:
        hit = next((each for each in event.hits if each.object_name == "surface"), None)
        if hit is None:
            return
        point = np.array((hit.x, hit.y, hit.z))
        if self._mode.value == "tool":
            self._place(point)
        else:
            self._add(point)

    def _add(self, point: Floats) -> None:
        taken = {each.name for each in self._landmarks}
        number = next(number for number in range(1, 1000) if f"landmark_{number}" not in taken)
        name = (self._name.value or "").strip() or f"landmark_{number}"
        if name in taken:
            ui.notify(self._texts("invalid", why=name), type="negative")
            return
        x, y, z = point.tolist()
        self._landmarks.append(LandmarkShown(name=name, planned=(x, y, z)))
        self._name.set_value("")
        self._draw()

    def _add_typed(self) -> None:
        point = self._typed(self._point.value)
        if point is not None:
            self._add(point)

    def _place_typed(self) -> None:
        point = self._typed(self._where.value)
        if point is not None:
            self._place(point)

    def _typed(self, text: str | None) -> Floats | None:
        """Three numbers, mm, as m."""
        try:
            numbers = [float(word) for word in (text or "").replace(",", " ").split()]
        except ValueError:
            numbers = []
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            ui.notify(self._texts("invalid", why=text or ""), type="negative")
            return None
        return np.array(numbers) / 1000.0

    def _place(self, point: Floats) -> None:
        """Stands the tool on the surface at a point of the image, m, (3,), its handle as it was."""
        if self._surface is None:
            return
        _, normals = self._surface.closest(point[None])
        before = np.eye(3) if self._pose is None else self._pose.rotation
        z = normals[0]
        y = before[:, 1] - (before[:, 1] @ z) * z
        if np.linalg.norm(y) < 1e-3:
            y = np.cross(z, before[:, 0])
        y /= np.linalg.norm(y)
        self._pose = on_scalp(self._surface.closest, Transform(np.column_stack((np.cross(y, z), y, z)), point))
        self._draw()

    def _clear(self) -> None:
        self._landmarks = []
        self._draw()

    async def _send_landmarks(self) -> None:
        planned = [{"name": each.name, "position": list(each.planned)} for each in self._landmarks]
        await self._asking.ask("registration.plan_landmarks", {"landmarks": planned})

    async def _send_pose(self) -> None:
        if self._pose is None:
            ui.notify(self._texts("click_tool"), type="warning")
            return
        arguments: dict[str, Any] = {
            "position": self._pose.translation.tolist(),
            "quat_xyzw": self._pose.quat_xyzw.tolist(),
        }
        await self._asking.ask("toolplan.plan", arguments)

    def _draw(self) -> None:
        for ball in self._balls:
            ball.delete()
        with self._scene:
            self._balls = [
                self._scene.sphere(0.004).material(LANDMARK).move(*each.planned).with_name(f"landmark {each.name}")
                for each in self._landmarks
            ]
        self._list.clear()
        with self._list:
            for each in self._landmarks:
                x, y, z = (1000.0 * value for value in each.planned)
                ui.label(f"{each.name}: {x:.1f} {y:.1f} {z:.1f} mm")
        show(self._tool, self._pose)
        if self._pose is not None:
            x, y, z = (1000.0 * self._pose.translation).tolist()
            self._shown.set_text(f"{x:.1f} {y:.1f} {z:.1f} mm")
