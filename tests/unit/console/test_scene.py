"""Shapes move to their pose, and a browser is not kept busy by changes that nobody can see."""

from __future__ import annotations

import numpy as np
import pytest
from nicegui import ui

from pcmrs.console._scene import STILL, fit, ignore_drags, put, show, tool
from pcmrs.spatial import Transform
from tests.unit.console.detached_page import DetachedPage
from tests.unit.console.shown_cell import setup, some_pose


def test_a_shape_is_put_where_the_pose_is(page: DetachedPage) -> None:
    with ui.scene() as scene:
        shape = scene.box()
    pose = some_pose(1)
    put(shape, pose)
    np.testing.assert_allclose((shape.x, shape.y, shape.z), pose.translation, atol=1e-5)
    np.testing.assert_allclose(shape.R, pose.rotation, atol=1e-5)


def test_noise_of_the_tracker_moves_nothing(page: DetachedPage) -> None:
    with ui.scene() as scene:
        shape = scene.box()
    put(shape, Transform.identity())
    before = (shape.x, shape.y, shape.z)
    put(shape, Transform.from_rotvec((0.9 * STILL, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert (shape.x, shape.y, shape.z) == before
    put(shape, Transform.from_rotvec((1.1 * STILL, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert shape.x == pytest.approx(1.1 * STILL, abs=1e-5)


def test_a_shape_without_a_pose_is_hidden_until_it_has_one(page: DetachedPage) -> None:
    with ui.scene() as scene:
        shape = scene.box()
    show(shape, None)
    assert not shape.visible_
    show(shape, some_pose(2))
    assert shape.visible_
    assert shape.x == pytest.approx(some_pose(2).translation[0], abs=1e-5)


def test_disc_and_handle_stand_on_the_contact_along_their_axes(page: DetachedPage) -> None:
    """Its lower face is at the contact, +z away from the body; the handle is outside the disc, along -y."""
    with ui.scene() as scene:
        group = tool(scene, setup(), "#000000", 1.0)
    disc, handle = [each for each in scene.objects.values() if each.parent is group]
    assert (disc.x, disc.y, disc.z) == pytest.approx((0.0, 0.0, setup().tool_half_length))
    assert np.linalg.det(disc.R) == pytest.approx(1.0)
    np.testing.assert_allclose(np.array(disc.R) @ (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # the axis of a cylinder is y
    assert handle.x == 0.0
    assert handle.y < -setup().tool_radius


def test_scripts_of_a_scene_name_that_scene(page: DetachedPage) -> None:
    scenes = [ui.scene(), ui.scene()]
    for scene in scenes:
        fit(scene)
        ignore_drags(scene)
        scripts = [str(each.js_handler) for each in scene._event_listeners.values() if each.js_handler]
        assert len(scripts) == 2
        assert all(f"({scene.id})" in script and "{{" not in script for script in scripts)
