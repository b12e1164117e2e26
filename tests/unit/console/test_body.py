"""The body in the scene: hidden until its pose is known, with landmarks that show how well they fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from msgspec.structs import replace
from nicegui import ui

from pcmrs.console._body import BodyView
from pcmrs.console._scene import GOOD, OPEN, POOR
from pcmrs.console._surfaces import Surfaces
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView, SurfaceShown
from pcmrs.spatial import Transform, distance
from pcmrs.workflows.data import as_message
from tests.unit.console.detached_page import DetachedPage, ShownCell
from tests.unit.console.shown_cell import setup, some_pose

REGISTERED = Transform.from_rotvec((0.1, 0.0, 0.0), (0.0, 0.0, 0.3))
SURFACE = SurfaceShown(vertices=np.zeros((3, 3), "<f4").tobytes(), faces=np.array([[0, 1, 2]], "<u4").tobytes())


def landmark(name: str, off: float | None) -> LandmarkShown:
    planned = (0.01, 0.02, 0.03)
    x, y, z = (REGISTERED @ np.array(planned)).tolist()
    return LandmarkShown(name=name, planned=planned, digitized=None if off is None else (x + off, y, z))


def view_of(page: DetachedPage, view: ShownCell, surfaces: Any = None, **changed: Any) -> BodyView:
    with ui.scene() as scene:
        pass
    return BodyView(scene, view, replace(setup(), **changed), surfaces)


def test_image_is_shown_where_registration_and_tracker_put_it(page: DetachedPage) -> None:
    view = ShownCell()
    shown = view_of(page, view, surface=SURFACE)
    assert shown.follow(some_pose(1), zone=True) is None, "nothing is registered"
    (group,), (reference,) = page.shapes()["body"], page.shapes()["body_ref"]
    assert not group.visible_
    assert reference.visible_
    view.data = ProcedureDataView(landmarks=[], body_ref_from_image=as_message(REGISTERED))
    image = shown.follow(some_pose(1), zone=True)
    assert image is not None
    assert distance(image, some_pose(1) @ REGISTERED) < 1e-9
    assert group.visible_
    assert shown.follow(None, zone=True) is None, "the tracker does not see the reference"
    assert not group.visible_


def test_a_landmark_has_the_colour_of_its_distance(page: DetachedPage) -> None:
    view = ShownCell()
    shown = view_of(page, view)
    view.data = ProcedureDataView(
        landmarks=[landmark("good", 0.001), landmark("poor", 0.005), landmark("open", None)],
        body_ref_from_image=as_message(REGISTERED),
    )
    shown.follow(some_pose(1), zone=False)
    shapes = page.shapes()
    colours = {name: each.color for name, (each,) in shapes.items() if name.startswith(("landmark", "digitized"))}
    assert colours == {
        "landmark good": GOOD, "digitized good": GOOD, "landmark poor": POOR, "digitized poor": POOR,
        "landmark open": OPEN,
    }  # fmt: skip
    assert shapes["landmark good"][0].parent is shapes["body"][0], "planned ones are in the image"
    assert shapes["digitized good"][0].parent is shapes["body_ref"][0]
    view.data = ProcedureDataView(landmarks=[])
    shown.follow(some_pose(1), zone=False)
    assert not any(name.startswith("landmark") for name in page.shapes()), "nothing old is left"


def test_the_zone_is_shown_only_if_wanted(page: DetachedPage) -> None:
    shown = view_of(page, ShownCell(), surface=SURFACE)
    for wanted in (True, False):
        shown.follow(None, zone=wanted)
        assert page.shapes()["zone of the body"][0].visible_ is wanted


async def test_the_error_takes_the_place_of_the_plain_surface(page: DetachedPage) -> None:
    class Served(Surfaces):
        """One address, or none while nothing is predicted."""

        where: str | None = None

        def __init__(self) -> None:
            pass

        async def error(self, *_: object) -> str | None:
            return self.where

    surfaces = Served()
    with page.client:
        shown = view_of(page, ShownCell(), surfaces, surface=SURFACE)
        (plain,) = page.shapes()["surface"]
        await shown.colour(wanted=True)
        assert plain.visible_, "nothing is predicted"
        for surfaces.where in ("/error/1.glb", "/error/2.glb"):
            await shown.colour(wanted=True)
            assert len(page.shapes()["predicted error"]) == 1
            assert not plain.visible_
        await shown.colour(wanted=False)
    assert "predicted error" not in page.shapes()
    assert plain.visible_
