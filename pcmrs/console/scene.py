"""The cell in three dimensions: arm, tool, body, landmarks, fixed boxes; planned green, measured red."""

from __future__ import annotations

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D
from scipy.spatial.transform import Rotation

from pcmrs.console.feed import Feed
from pcmrs.console.geometry import Sight, residuals
from pcmrs.messages.setup import Setup
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.data import as_transform

RATE = 30.0
"""Updates per second."""
SURFACE = "/body.stl"

PLANNED, MEASURED = "#009e73", "#d55e00"
"""Green and red that are told apart by who sees no difference of those (Okabe and Ito)."""
ARM, SKIN, BOX, OPEN, GOOD, POOR = "#9aa5b1", "#e8c9a8", "#b8c4d6", "#56b4e9", "#009e73", "#d55e00"
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T
"""The tool's axes from those of a cylinder of the scene, whose axis is y."""


class ScenePanel:
    """Follows the cell for as long as its page is open.

    Args:
        feed: What the cell tells.
        setup: Of the cell.
    """

    def __init__(self, feed: Feed, setup: Setup) -> None:
        self._feed, self._setup = feed, setup
        self._sight = Sight(setup)
        self._version = -1
        self._landmarks: list[Object3D] = []
        with ui.scene(width=10, height=10, grid=False, fps=int(RATE), background_color="#f4f6f8") as scene:
            self.scene = scene.classes("w-full h-full").props('aria-label="Scene"')
            self._links = [self._link(span) for span in self._sight.arm.spans]
            for box in setup.boxes:
                shape = scene.box(*box.size).material(BOX, 0.35).with_name(f"box {box.name}")
                put(shape, as_transform(box.pose))
            self._body = self._group_of_body()
            self._planned = self._tool(PLANNED, 0.55, "planned")
            self._measured = self._tool(MEASURED, 0.85, "measured")
        scene.move_camera(1.45, -1.0, 0.95, 0.35, 0.0, 0.35, duration=0.0)
        ui.timer(1.0 / RATE, self._follow)

    def _link(self, span: Floats) -> Object3D:
        """A group with a ball at a joint and a bar to the next."""
        radius = self._sight.arm.radius
        with self.scene.group() as group:
            self.scene.sphere(radius).material(ARM)
            length = float(np.linalg.norm(span))
            if length > 1e-3:
                bar = self.scene.cylinder(0.8 * radius, 0.8 * radius, length, 24).material(ARM)
                put(bar, Transform(_along(span / length), span / 2.0))
        return group.with_name("link")

    def _tool(self, colour: str, opacity: float, name: str) -> Object3D:
        """A disc or rod about its z axis, with its handle along -y."""
        radius, half = self._setup.tool_radius, self._setup.tool_half_length
        with self.scene.group() as group:
            disc = self.scene.cylinder(radius, radius, 2.0 * half, 48).material(colour, opacity)
            put(disc, Transform(AXES, np.array((0.0, 0.0, half))))
            handle = self.scene.box(0.02, 0.16, 0.02).material(colour, opacity)
            handle.move(0.0, -radius - 0.07, half)
        return group.with_name(name).visible(False)

    def _group_of_body(self) -> Object3D:
        """What moves with the image: surface and landmarks."""
        with self.scene.group() as group:
            if self._setup.surface is not None:
                self.scene.stl(SURFACE).material(SKIN, 0.9).with_name("surface")
        return group.with_name("body").visible(False)

    def _follow(self) -> None:
        feed = self._feed
        if feed.joints is None:
            return
        coil, body_ref = feed.poses.get("coil"), feed.poses.get("body_ref")
        frames = self._sight.see(feed.joints.positions, coil, moving=feed.joints.moving)
        for link, frame in zip(self._links, frames, strict=False):
            put(link, frame)
        show(self._measured, self._sight.in_base(coil))
        registered, base_from_body_ref = feed.data.body_ref_from_image, self._sight.in_base(body_ref)
        image = None
        if registered is not None and base_from_body_ref is not None:
            image = base_from_body_ref @ as_transform(registered)
        show(self._body, image)
        plan = feed.data.plan
        show(self._planned, None if image is None or plan is None else image @ as_transform(plan))
        if feed.version != self._version:
            self._version = feed.version
            self._draw_landmarks()

    def _draw_landmarks(self) -> None:
        """Planned landmarks, coloured by how far they are from where they were digitized."""
        for each in self._landmarks:
            each.delete()
        self._landmarks = []
        data = self._feed.data
        with self.scene, self._body:
            for landmark, residual in zip(data.landmarks, residuals(data), strict=True):
                colour = OPEN if residual is None else GOOD if residual <= self._setup.residual_limit else POOR
                ball = self.scene.sphere(0.004).material(colour).with_name(f"landmark {landmark.name}")
                self._landmarks.append(ball.move(*landmark.planned))


def put(shape: Object3D, pose: Transform) -> None:
    """Puts a shape at a pose; says nothing to the page where it is there already."""
    x, y, z = np.round(pose.translation, 5).tolist()
    shape.move(x, y, z).rotate_R(np.round(pose.rotation, 5).tolist())


def show(shape: Object3D, pose: Transform | None) -> None:
    """Puts a shape at a pose, or hides it."""
    if shape.visible_ != (pose is not None):
        shape.visible(pose is not None)
    if pose is not None:
        put(shape, pose)


def _along(axis: Floats) -> Floats:
    """A rotation that takes y to a unit vector (3,)."""
    rotation, _ = Rotation.align_vectors([axis], [[0.0, 1.0, 0.0]])
    return np.asarray(rotation.as_matrix())
