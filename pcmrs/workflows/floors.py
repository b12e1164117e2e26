"""How near an arm may come to what it keeps out of, once it is on its way."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError
from pcmrs.workflows.cell import Cell


class Floors:
    """Least distances of a motion: as near as allowed, or as planned where that is nearer, less the drift.

    Args:
        cell: With its zones arranged.
        positions: The planned motion, rad, (N, n).
    """

    def __init__(self, cell: Cell, positions: npt.ArrayLike) -> None:
        zones = cell.zones
        self._model = zones.model
        planned = zones.look_at(positions).distances.min(axis=0)
        # A tool that is planned to come near the body may touch it; any other keeps off it.
        limits = np.where(planned < zones.limits_afar, zones.limits, zones.limits_afar)
        self._floors = np.minimum(limits, planned) - cell.settings.zones.drift_limit

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
