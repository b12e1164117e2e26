"""How near an arm may come to what it keeps out of, once it is on its way."""

from __future__ import annotations

import asyncio
from typing import Self

import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError
from pcmrs.spatial import Floats as Numbers
from pcmrs.workflows.cell import Cell

PART = 32
"""So many samples of a motion are looked at in one go, which takes about a millisecond."""


class Floors:
    """Least distances of a motion: as near as allowed, or as planned where that is nearer, less the drift.

    Args:
        cell: With its zones arranged.
        planned: Least distance of every pair along the planned motion, m, (P,).
    """

    def __init__(self, cell: Cell, planned: Numbers) -> None:
        zones = cell.zones
        self._model = zones.model
        # A tool that is planned to come near the body may touch it; any other keeps off it.
        limits = np.where(planned < zones.limits_afar, zones.limits, zones.limits_afar)
        self._floors = np.minimum(limits, planned) - cell.settings.zones.drift_limit

    @classmethod
    def at(cls, cell: Cell, posture: npt.ArrayLike) -> Self:
        """Of an arm that stands at a posture, rad, (n,)."""
        return cls(cell, cell.zones.model.distances(posture))

    @classmethod
    async def along(cls, cell: Cell, positions: npt.ArrayLike) -> Self:
        """Of a planned motion, rad, (N, n).

        A long one takes tens of milliseconds, and Stop may wait for the event loop no longer than a few of them.
        """
        samples, planned = np.asarray(positions), []
        for start in range(0, len(samples), PART):  # each part ends where the next one begins
            planned.append(cell.zones.look_at(samples[start : start + PART + 1]).distances.min(axis=0))
            await asyncio.sleep(0)
        return cls(cell, np.min(planned, axis=0))

    def passed(self, positions: npt.ArrayLike) -> RefusalError | None:
        """Why an arm with its joints there, rad, (n,), is to be held, if it is."""
        distances = self._model.distances(positions)
        pair = int(np.argmin(distances - self._floors))
        floor = float(self._floors[pair])
        if distances[pair] >= floor:
            return None
        found = self._model.clearance(distances, pair)
        text = (
            f"{found.link} came within {found.distance * 1000:.0f} mm of {found.zone}, nearer than {floor * 1000:.0f} "
            "mm, and the arm was held. Look at the cell, then back off."
        )
        fields = {"link": found.link, "zone": found.zone, "distance": found.distance, "limit": floor}
        return RefusalError("zone_entered", text, **fields)
