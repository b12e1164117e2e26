"""Shapes in a scene, and the colours that have the same meaning in all scenes."""

from __future__ import annotations

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console._colours import GREEN, GREY, SKY, VERMILION
from pcmrs.messages.setup import Setup
from pcmrs.spatial import Transform

SURFACE = "/body.stl"
BACKGROUND = "#f4f6f8"

PLANNED, MEASURED = GREEN, VERMILION
ARM, SKIN, BOX, OPEN, GOOD, POOR = GREY, "#e8c9a8", "#b8c4d6", SKY, GREEN, VERMILION
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation from a cylinder of the scene, whose axis is y, to the tool, whose axis is z."""


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
    """Make a scene fill its container, and not draw in a hidden tab; by itself it follows the window only."""
    scene.on("init", js_handler=FITTED.format(id=scene.id))


def ignore_drags(scene: ui.scene) -> None:
    """Ignore clicks at the end of a drag, which browsers report, too."""
    scene.on("init", js_handler=UNDRAGGED.format(id=scene.id))


STILL, STRAIGHT = 2e-4, 1e-3
"""Smaller motions, m, and turns, rad, are not shown: the noise of the tracker would keep a browser busy
with invisible changes."""


def put(shape: Object3D, pose: Transform) -> None:
    """Move a shape to a pose; nothing is sent to the page if it is nearly there already.

    Args:
        shape: The shape.
        pose: Its pose in the scene.
    """
    if np.abs(pose.translation - (shape.x, shape.y, shape.z)).max() > STILL:
        shape.move(*np.round(pose.translation, 5).tolist())
    if np.abs(pose.rotation - np.array(shape.R)).max() > STRAIGHT:
        shape.rotate_R(np.round(pose.rotation, 5).tolist())


def tool(scene: ui.scene, setup: Setup, colour: str, opacity: float) -> Object3D:
    """Return a disc or rod about its z axis, with its handle along -y.

    Args:
        scene: Scene to draw in.
        setup: Setup of the cell.
        colour: Colour of the tool.
        opacity: 0 to 1.
    """
    radius, half = setup.tool_radius, setup.tool_half_length
    with scene.group() as group:
        disc = scene.cylinder(radius, radius, 2.0 * half, 24).material(colour, opacity)
        put(disc, Transform(AXES, np.array((0.0, 0.0, half))))
        handle = scene.box(0.02, 0.16, 0.02).material(colour, opacity)
        handle.move(0.0, -radius - 0.07, half)
    return group


def show(shape: Object3D, pose: Transform | None) -> None:
    """Move a shape to a pose, or hide it.

    Args:
        shape: The shape.
        pose: Its pose in the scene; None hides it.
    """
    if shape.visible_ != (pose is not None):
        shape.visible(pose is not None)
    if pose is not None:
        put(shape, pose)
