"""Browsers get the surface of the body, and the predicted error only as it is now."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import trimesh
from fastapi import FastAPI
from fastapi.routing import APIRoute

from pcmrs.console._scene import SURFACE
from pcmrs.console._surfaces import LIGHTER, MAX_COLOURED, ZONE, Surfaces
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView, Setup, SurfaceShown
from pcmrs.workflows.data import as_message
from tests.unit.console.shown_cell import setup, some_pose

HEAD = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
SHOWN = SurfaceShown(vertices=HEAD.vertices.astype("<f4").tobytes(), faces=HEAD.faces.astype("<u4").tobytes())
WITH_HEAD = msgspec.structs.replace(setup(), surface=SHOWN, body_margin=0.02)
POINTS = ((0.09, 0.0, 0.0), (0.0, 0.09, 0.0), (-0.09, 0.0, 0.0), (0.0, 0.0, 0.09))


def registered(sigma: float) -> ProcedureDataView:
    landmarks = [LandmarkShown(name=str(number), planned=point) for number, point in enumerate(POINTS)]
    return ProcedureDataView(landmarks=landmarks, body_ref_from_image=as_message(some_pose(1)), sigma=sigma)


def served(known: Setup | None) -> tuple[Surfaces, dict[str, Any]]:
    """The surfaces, and what answers at each address."""
    feed: Any = SimpleNamespace(setup=known)
    app, surfaces = FastAPI(), Surfaces(feed)
    surfaces.declare(app)
    return surfaces, {route.path: route.endpoint for route in app.routes if isinstance(route, APIRoute)}


def test_the_whole_surface_and_its_zone_are_meshes_in_metres() -> None:
    _, at = served(WITH_HEAD)
    whole, zone = (trimesh.load_mesh(io.BytesIO(at[address]().body), file_type="stl") for address in (SURFACE, ZONE))
    assert whole.volume == pytest.approx(HEAD.volume, rel=1e-4)
    assert zone.bounds == pytest.approx(np.array([[-0.12] * 3, [0.12] * 3]), abs=4e-3)
    assert at[LIGHTER]().media_type == "model/stl"


@pytest.mark.parametrize("known", [None, setup()])
def test_without_a_surface_there_is_nothing_at_its_address(known: Setup | None) -> None:
    _, at = served(known)
    assert {at[address]().status_code for address in (SURFACE, LIGHTER, ZONE)} == {404}


async def test_the_error_has_an_address_that_changes_with_it() -> None:
    surfaces, at = served(WITH_HEAD)
    assert await surfaces.error(WITH_HEAD, ProcedureDataView(landmarks=[])) is None, "nothing is registered"
    assert await surfaces.error(setup(), registered(0.001)) is None, "there is no surface"
    first = await surfaces.error(WITH_HEAD, registered(0.001))
    assert first is not None
    assert await surfaces.error(WITH_HEAD, registered(0.001)) == first, "all pages of a cell share it"
    second = await surfaces.error(WITH_HEAD, registered(0.002))
    assert second != first
    endpoint = at["/error/{key}.glb"]
    assert endpoint(key=first.removeprefix("/error/").removesuffix(".glb")).body.startswith(b"glTF")
    assert endpoint(key="none").status_code == 404


async def test_only_the_newest_coloured_surfaces_are_kept() -> None:
    surfaces, at = served(WITH_HEAD)
    found = [await surfaces.error(WITH_HEAD, registered(0.001 * number)) for number in range(1, MAX_COLOURED + 2)]
    keys = [str(each).removeprefix("/error/").removesuffix(".glb") for each in found]
    status = [at["/error/{key}.glb"](key=key).status_code for key in keys]
    assert status == [404] + [200] * MAX_COLOURED
