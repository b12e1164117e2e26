"""Likely place of the body before a registration, from the last accepted one, to keep away from it.

Registrations are never restored automatically. One of the same patient, reference and calibration still shows where the
arm should not go: it adds a zone and a point to keep away from, but nothing is planned or measured with it.
"""

from __future__ import annotations

import numpy as np

from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import JointTrajectory
from pcmrs.workflows._arguments import Retreat
from pcmrs.workflows._landmarks import check_same_head
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Registered
from pcmrs.workflows.reference import RECENT, check_reference

MIN_MOTION = 0.01
"""Least motion of a joint that counts as motion, rad."""


def earlier_registration(cell: Cell, data: PlacementData) -> Registered | None:
    """Return the last accepted registration if this run of the daemon has had none and it still fits; otherwise None.

    Args:
        cell: Cell with the tracked poses.
        data: Data of the procedure.
    """
    if cell.body_ref_from_image is not None or data.previous is None:
        return None
    try:
        check_same_head(cell, data.previous)
        check_reference(cell, data.previous.reference, cell.clock.monotonic() - RECENT)
    except RefusalError:
        return None
    return data.previous


def check_confirmed(run: AnyRun[Cell, PlacementData], trajectory: JointTrajectory) -> None:
    """Refuse a path that can only be checked against the reference.

    It is accepted if a person confirms it or if it does not move the arm.

    Args:
        run: Present operation.
        trajectory: Planned path.

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
        f"The place of the body is not known: there has been no registration since the daemon started, and {why}. "
        "Register, or look at the whole path of the arm and send the command again with confirm: true."
    )
    raise RefusalError("body_not_registered", text)
