"""Where the body is likely to be before a registration: by the last accepted one, to keep away from it.

Registrations are never restored by themselves. One of the same patient, reference and calibration still says where the
arm had better not go: it adds a zone and a middle to keep away from, and nothing is planned or measured by it.
"""

from __future__ import annotations

import numpy as np

from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import JointTrajectory
from pcmrs.workflows.arguments import Retreat
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Registered
from pcmrs.workflows.landmarks import check_same_head
from pcmrs.workflows.reference import RECENT, check_reference

MIN_MOTION = 0.01
"""A way on which no joint goes farther leads nowhere, rad."""


def earlier_registration(cell: Cell, data: PlacementData) -> Registered | None:
    """Return the last accepted registration where this run of the daemon has seen none, and it still fits."""
    if cell.body_ref_from_image is not None or data.previous is None:
        return None
    try:
        check_same_head(cell, data.previous)
        check_reference(cell, data.previous.reference, cell.clock.monotonic() - RECENT)
    except RefusalError:
        return None
    return data.previous


def check_confirmed(run: AnyRun[Cell, PlacementData], trajectory: JointTrajectory) -> None:
    """Refuse a way that nothing can be held against but the reference, unless it is confirmed or leads nowhere.

    Raises:
        RefusalError: ``body_not_registered``.
    """
    cell, data = run.cell, run.data
    if data.registered is not None or cell.body_ref_from_image is not None or earlier_registration(cell, data):
        return
    positions = np.asarray(trajectory.positions)
    if np.abs(positions - positions[0]).max() <= MIN_MOTION:
        return
    if isinstance(run.payload, Retreat) and run.payload.confirm:
        run.result["body_not_registered"] = True
        return
    why = "none is known" if data.previous is None else "the last one is of another patient, reference or calibration"
    text = (
        f"Where the body is cannot be told: there has been no registration since the daemon started, and {why}. "
        "Register, or look at the whole way of the arm and ask again with confirm: true."
    )
    raise RefusalError("body_not_registered", text)
