"""The image in three dimensions: a click on the surface is a point, and the plan is drawn where it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from msgspec.structs import replace
from nicegui import ui

from pcmrs.console.planning._canvas import Canvas
from pcmrs.messages.setup import SurfaceShown
from pcmrs.spatial import Floats
from tests.unit.console.detached_page import DetachedPage
from tests.unit.console.planning.drafts import RADIUS, direction, draft
from tests.unit.console.shown_cell import setup

SURFACE = SurfaceShown(vertices=np.zeros((3, 3), "<f4").tobytes(), faces=np.array([[0, 1, 2]], "<u4").tobytes())


def click(page: DetachedPage, *hits: tuple[str, float]) -> None:
    """A click that hits these objects, the nearest first, at x."""
    found: Any = SimpleNamespace(hits=[SimpleNamespace(object_name=name, x=x, y=0.2, z=0.3) for name, x in hits])
    for handler in page.only(ui.scene)._click_handlers:
        handler(found)


def test_only_a_click_on_the_surface_is_a_point(page: DetachedPage) -> None:
    picked: list[Floats] = []
    Canvas(replace(setup(), surface=SURFACE), picked.append)
    click(page, ("landmark 1", 0.0), ("surface", 0.1), ("surface", -0.1))
    click(page, ("landmark 1", 0.0))
    click(page)
    (point,) = picked
    np.testing.assert_allclose(point, (0.1, 0.2, 0.3))


def test_the_plan_is_drawn_where_it_is_and_replaces_the_last_one(page: DetachedPage) -> None:
    canvas, plan = Canvas(setup(), lambda _: None), draft()
    plan.add_landmark(RADIUS * direction(1), "nasion")
    plan.place(RADIUS * direction(2))
    plan.lay_grid(0.01, 2, 2)
    plan.entry, plan.end = np.array((0.0, 0.0, 0.09)), np.array((0.0, 0.0, 0.04))
    for _ in range(2):
        canvas.draw(plan, plan.pose)
    shapes = page.shapes()
    assert sorted(shapes) == ["end", "entry", "grid 1", "grid 2", "grid 3", "grid 4", "landmark nasion", "trajectory"]
    assert all(len(each) == 1 for each in shapes.values()), "nothing of the first drawing is left"
    (nasion,) = shapes["landmark nasion"]
    np.testing.assert_allclose((nasion.x, nasion.y, nasion.z), RADIUS * direction(1), atol=1e-5)
    plan.end = None
    canvas.draw(plan, None)
    assert "trajectory" not in page.shapes()


def test_another_surface_takes_the_place_of_the_first(page: DetachedPage) -> None:
    canvas = Canvas(replace(setup(), surface=SURFACE), lambda _: None)
    (first,) = page.shapes()["surface"]
    canvas.show_surface("/planning/a.stl")
    (second,) = page.shapes()["surface"]
    assert second is not first
    assert second.args[0] == "/planning/a.stl"
    canvas.show_cortex("/planning/b.stl")
    canvas.show_cortex("/planning/c.stl")
    assert [each.args[0] for each in page.shapes()["cortex"]] == ["/planning/c.stl"]
    assert second.opacity < 1.0, "the cortex can be seen through it"
    canvas.show_surface(None)
    assert "surface" not in page.shapes()
