"""What the tracker sees: a line of sight and a word for each body, and the edges of its measuring volume."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from nicegui import ui

from pcmrs.console._geometry import TrackerLocator
from pcmrs.console._tracking import MAX_AGE, TrackingView, VisibilityRow, edges
from pcmrs.messages.setup import SliceShown
from pcmrs.spatial import Transform
from tests.unit.console.detached_page import ENGLISH, DetachedPage, ShownCell
from tests.unit.console.shown_cell import FLANGE_FROM_TOOL_TIP, body, setup, some_pose

VOLUME = [SliceShown(distance=1.0, width=0.4, height=0.2), SliceShown(distance=2.0, width=0.8, height=0.6)]


def test_the_volume_has_twelve_edges_in_front_of_the_tracker() -> None:
    found = edges(VOLUME)
    assert len(found) == 12
    corners = {tuple(np.round(end, 9)) for edge in found for end in edge}
    assert corners == {
        (x * each.width / 2, y * each.height / 2, -each.distance) for each in VOLUME for x in (-1, 1) for y in (-1, 1)
    }
    lengths = sorted(float(np.linalg.norm(end - start)) for start, end in found)
    across = [0.2, 0.2, 0.4, 0.4, 0.6, 0.6, 0.8, 0.8]
    assert lengths == pytest.approx(sorted([*across, *[np.sqrt(1.0 + 0.2**2 + 0.2**2)] * 4]))
    assert edges([]) == []


def test_a_body_is_seen_only_while_it_is_reported(page: DetachedPage) -> None:
    view, row = ShownCell(), VisibilityRow(ENGLISH)
    view.poses = {
        "coil": body("coil", Transform.identity()),
        "pointer": replace(body("pointer", Transform.identity(), valid=False), reason="too_far"),
    }
    view.received = {"coil": 0.0, "pointer": 0.0}
    row.follow(view)
    seen, not_seen = ENGLISH("seen"), ENGLISH("not_seen")
    assert page.text("visibility").splitlines() == [f"● coil: {seen}", f"○ pointer: {not_seen} (too far)"]
    view.now = MAX_AGE + 0.01
    row.follow(view)
    assert page.text("visibility").splitlines()[0] == f"○ coil: {not_seen}", "its last report is no longer true"


def test_a_line_of_sight_leads_from_the_tracker_to_the_body(page: DetachedPage) -> None:
    view, locator = ShownCell(), TrackerLocator(setup())
    with ui.scene() as scene:
        tracking = TrackingView(scene, replace(setup(), volume=VOLUME))
    base_from_tracker, base_from_ref = some_pose(1), some_pose(2)
    tool = base_from_tracker.inverse() @ locator.arm.frames([0.0] * 7)[-1] @ FLANGE_FROM_TOOL_TIP
    view.poses["body_ref"] = body("body_ref", base_from_tracker.inverse() @ base_from_ref)
    view.received["body_ref"] = 0.0
    tracking.follow(view, locator, wanted=True)
    (tracker,), (sight,) = page.shapes()["tracker"], page.shapes()["sight of body_ref"]
    assert not tracker.visible_, "nobody knows yet where it is"
    assert not sight.visible_
    locator.see([0.0] * 7, tool, moving=False)
    tracking.follow(view, locator, wanted=True)
    assert tracker.visible_
    middle = (base_from_tracker.translation + base_from_ref.translation) / 2.0
    np.testing.assert_allclose((sight.x, sight.y, sight.z), middle, atol=1e-3)
    length = float(np.linalg.norm(base_from_tracker.translation - base_from_ref.translation))
    assert sight.sy == pytest.approx(length, abs=1e-3)
    assert not page.shapes()["sight of coil"][0].visible_, "its pose has never come"
    tracking.follow(view, locator, wanted=False)
    assert not tracker.visible_
    assert not sight.visible_
