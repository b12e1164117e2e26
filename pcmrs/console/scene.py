"""How something is put into a scene, and the colours that mean the same in all of them."""

from __future__ import annotations

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console.colours import GREEN, GREY, SKY, VERMILION
from pcmrs.messages.setup import Setup
from pcmrs.spatial import Transform

SURFACE = "/body.stl"
BACKGROUND = "#f4f6f8"

PLANNED, MEASURED = GREEN, VERMILION
ARM, SKIN, BOX, OPEN, GOOD, POOR = GREY, "#e8c9a8", "#b8c4d6", SKY, GREEN, VERMILION
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T
"""The tool's axes from those of a cylinder of the scene, whose axis is y."""


FITTED = """() => {{
    new ResizeObserver(() => getElement({id}).resize()).observe(getHtmlElement({id}));
}}"""

UNDRAGGED = """() => {{
    const place = getHtmlElement({id});
    let from = null;
    place.addEventListener("pointerdown", (event) => (from = event), true);
    place.addEventListener("click", (event) => {{
        if (Math.hypot(event.clientX - from.clientX, event.clientY - from.clientY) > 5) event.stopPropagation();
    }}, true);
}}"""


def fit(scene: ui.scene) -> None:
    """Draw a scene as large as its place, not at all in a hidden tab: by itself it looks at the window only."""
    scene.on("init", js_handler=FITTED.format(id=scene.id))


def ignore_drags(scene: ui.scene) -> None:
    """A mouse that turns the scene has clicked nothing: browsers tell of a click at the end of a drag, too."""
    scene.on("init", js_handler=UNDRAGGED.format(id=scene.id))


STILL, STRAIGHT = 2e-4, 1e-3
"""What moves by less, m, or turns by less, rad, stays where it is shown: noise of the tracker would keep a browser busy
that draws for nobody's eye."""


def put(shape: Object3D, pose: Transform) -> None:
    """Put a shape at a pose; says nothing to the page where it is about there already."""
    if np.abs(pose.translation - (shape.x, shape.y, shape.z)).max() > STILL:
        shape.move(*np.round(pose.translation, 5).tolist())
    if np.abs(pose.rotation - np.array(shape.R)).max() > STRAIGHT:
        shape.rotate_R(np.round(pose.rotation, 5).tolist())


def tool(scene: ui.scene, setup: Setup, colour: str, opacity: float) -> Object3D:
    """A disc or rod about its z axis, with its handle along -y."""
    radius, half = setup.tool_radius, setup.tool_half_length
    with scene.group() as group:
        disc = scene.cylinder(radius, radius, 2.0 * half, 24).material(colour, opacity)
        put(disc, Transform(AXES, np.array((0.0, 0.0, half))))
        handle = scene.box(0.02, 0.16, 0.02).material(colour, opacity)
        handle.move(0.0, -radius - 0.07, half)
    return group


def show(shape: Object3D, pose: Transform | None) -> None:
    """Put a shape at a pose, or hides it."""
    if shape.visible_ != (pose is not None):
        shape.visible(pose is not None)
    if pose is not None:
        put(shape, pose)
