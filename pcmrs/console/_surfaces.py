"""The body's surface for browsers: whole, lighter for display, and coloured by the predicted error."""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Callable

import msgspec
from fastapi import FastAPI, Response

from pcmrs.console._geometry import as_stl, as_zone, decimate, vertices_of
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console._residuals import coloured
from pcmrs.console._scene import SURFACE
from pcmrs.messages.setup import ProcedureDataView, Setup, SurfaceShown

MAX_COLOURED = 4
"""Number of stored coloured surfaces: pages of one cell ask for the same one."""
LIGHTER = "/lighter.stl"
ZONE = "/zone.stl"
COLOURED = "/error/{key}.glb"


class Surfaces:
    """Served surfaces of the body.

    Args:
        feed: State of the cell.
    """

    def __init__(self, feed: LiveFeed) -> None:
        self._feed = feed
        self._coloured: OrderedDict[str, bytes] = OrderedDict()

    def declare(self, app: FastAPI) -> None:
        """Declare the addresses of the surfaces."""

        @app.get(SURFACE)
        def surface() -> Response:
            return _stl(self._feed.setup, lambda _, shown: as_stl(*vertices_of(shown)))

        @app.get(LIGHTER)
        def light() -> Response:
            return _stl(self._feed.setup, lambda _, shown: as_stl(*vertices_of(decimate(shown))))

        @app.get(ZONE)
        def zone() -> Response:
            return _stl(self._feed.setup, lambda setup, shown: as_zone(vertices_of(shown)[0], setup.body_margin))

        @app.get(COLOURED)
        def error(key: str) -> Response:
            if key not in self._coloured:
                return Response(status_code=404)
            return Response(self._coloured[key], media_type="model/gltf-binary")

    async def error(self, setup: Setup, data: ProcedureDataView) -> str | None:
        """Return the address of the surface coloured by the present predicted error; None while that is unknown.

        Args:
            setup: Setup of the cell.
            data: Data of the procedure, with the registration in force.
        """
        if setup.surface is None:
            return None
        rests_on = (data.body_ref_from_image, [each.planned for each in data.landmarks], data.sigma, data.covariance)
        key = hashlib.sha256(setup.surface.vertices + msgspec.msgpack.encode(rests_on)).hexdigest()[:16]
        if key not in self._coloured:
            made = await asyncio.to_thread(coloured, setup.surface, data, setup.tre_limit)
            if made is None:
                return None
            self._coloured[key] = made
            while len(self._coloured) > MAX_COLOURED:
                self._coloured.popitem(last=False)
        return COLOURED.format(key=key)


def _stl(setup: Setup | None, made: Callable[[Setup, SurfaceShown], bytes]) -> Response:
    if setup is None or setup.surface is None:
        return Response(status_code=404)
    return Response(made(setup, setup.surface), media_type="model/stl")
