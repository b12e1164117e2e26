"""Forms of the planning change the draft, or leave it as it was and say why."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.console.planning._draft import Draft
from pcmrs.console.planning._forms import DraftEditor, GridForm, LandmarkForm, ToolForm, TrajectoryForm
from tests.unit.console.detached_page import ENGLISH, DetachedPage
from tests.unit.console.planning.drafts import RADIUS, direction, draft


class Edited:
    """A draft and how often it has changed."""

    def __init__(self, plan: Draft | None = None) -> None:
        self.plan = draft() if plan is None else plan
        self.changes = 0
        self.editor = DraftEditor(self.plan, ENGLISH, self._changed)

    def _changed(self) -> None:
        self.changes += 1


async def test_a_landmark_has_the_typed_name_and_mm(page: DetachedPage) -> None:
    edited = Edited()
    with page.client:
        form = LandmarkForm(edited.editor)
    page.at("landmark-name").set_value("nasion")
    page.at("landmark-point").set_value("4 -12.5, 143")
    await page.press("add-landmark")
    (landmark,) = edited.plan.landmarks
    assert landmark.name == "nasion"
    assert landmark.planned == pytest.approx((0.004, -0.0125, 0.143))
    form.refresh()
    assert page.text("landmarks") == "nasion: 4.0 -12.5 143.0 mm"
    assert page.at("landmark-name").value == "", "the next one has another name"
    await page.press("clear-landmarks")
    assert edited.plan.landmarks == []
    assert edited.changes == 2


async def test_what_is_refused_is_shown_and_changes_nothing(page: DetachedPage) -> None:
    edited = Edited()
    with page.client:
        LandmarkForm(edited.editor)
    page.at("landmark-point").set_value("4 -12")
    await page.press("add-landmark")
    assert (edited.plan.landmarks, edited.changes) == ([], 0)
    (shown,) = page.notified
    assert "is not three numbers" in shown


async def test_a_tool_needs_a_surface_and_shows_its_place_and_depth(page: DetachedPage) -> None:
    edited, without = Edited(), Edited(Draft())
    with page.client:
        form = ToolForm(edited.editor, cortex=True)
    with page.client:
        without.editor.do(lambda: without.plan.place(np.zeros(3)))
    assert without.changes == 0
    assert "There is no surface" in page.notified[-1]
    page.at("tool-point").set_value("0 0 100")
    await page.press("place-tool")
    assert edited.plan.pose is not None
    form.refresh()
    assert page.text("tool-pose").startswith("0.0 0.0 ")
    before = edited.plan.pose
    await page.press("nudge-ArrowUp")
    moved = float(np.linalg.norm(edited.plan.pose.translation - before.translation))
    assert moved == pytest.approx(0.001, abs=1e-4)
    page.at("target-point").set_value("0 0 60")
    await page.press("project-target")
    assert edited.plan.depth == pytest.approx(RADIUS - 0.06, abs=1e-3)
    page.at("target-way").set_value("normal")
    await page.press("project-target")
    assert "needs a surface of the cortex" in page.notified[-1]


def test_after_the_entry_the_end_is_chosen_and_the_length_shown(page: DetachedPage) -> None:
    edited = Edited()
    form = TrajectoryForm(edited.editor)
    form.pick(np.array((0.0, 0.0, 0.09)))
    form.pick(np.array((0.0, 0.03, 0.05)))
    assert edited.plan.entry is not None
    assert edited.plan.end is not None
    form.refresh()
    assert ENGLISH("length", mm=50.0) in page.text("trajectory")
    form.pick(np.array((0.0, 0.0, 0.05)))
    np.testing.assert_allclose(edited.plan.end, (0.0, 0.0, 0.05))
    np.testing.assert_allclose(edited.plan.entry, (0.0, 0.0, 0.09))


async def test_a_grid_lies_around_the_picked_point(page: DetachedPage) -> None:
    edited = Edited()
    with page.client:
        form = GridForm(edited.editor)
    with page.client:
        edited.editor.do(lambda: form.pick(RADIUS * direction(1)))
    form.refresh()
    assert len(edited.plan.grid) == 9
    assert page.text("grid") == ENGLISH("grid_points", count=9)
    middle = np.mean([pose.translation for pose in edited.plan.grid], axis=0)
    assert np.linalg.norm(middle - RADIUS * direction(1)) < 0.005
    page.at("grid-rows").set_value(None)
    before = edited.plan.grid
    await page.press("lay-grid")
    assert edited.plan.grid == before
    assert "needs spacing, rows and columns" in page.notified[-1]
