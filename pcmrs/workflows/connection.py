"""Connecting the robot, and finding out where it is.

Nothing is measured or moved by a calibration that is expired, of something else, or changed.
"""

from __future__ import annotations

import numpy as np

from pcmrs.calibration import Expected, check_valid
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.paths import distance_from_body

Run = AnyRun[Cell, PlacementData]


def calibration_valid(run: Run) -> None:
    """Refuses where a configured calibration file must not be used; poses given in the configuration do not expire.

    Raises:
        RefusalError: Tool or pointer: see `check_valid`.
    """
    cell, settings = run.cell, run.cell.settings
    run.result["calibration"] = cell.calibrations()
    serials = {"tool": settings.calibration.tool_serial, "pointer": settings.calibration.pointer_serial}
    for calibration in (cell.tool_calibration, cell.pointer_calibration):
        if calibration is not None:
            expected = Expected(cell.name, settings.tool, serials[calibration.kind])
            check_valid(calibration, expected, run.clock.wall())


def register_calibration_checks(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the name that blueprints use for this check."""
    registry.check(calibration_valid)


FRAMES_TO_LOCATE = 5


async def connect_robot(run: Run) -> None:
    """Connected means that the robot has answered with joints within its limits.

    The devices may act from now on, unless Stop is latched: then only its acknowledgement releases them.
    """
    state = await run.cell.robot.connect()
    if not np.all(np.isfinite(state.positions)):
        raise RefusalError("bad_joints", f"The robot reports joints {state.positions}, which are no numbers.")
    run.cell.arm.check_limits(state.positions)
    run.cell.update_joints(state)
    if not run.latched and (latched := await run.cell.release(stopped=True)):
        run.result["still_latched"] = latched
    run.post("placement", "locate")


async def disconnect_robot(run: Run) -> None:
    """Ends the connection once the robot has confirmed it."""
    await run.cell.robot.disconnect()


async def locate_arm(run: Run) -> None:
    """Clear of the body or not, by the measured joints and the body as the tracker sees it."""
    cell = run.cell
    cell.update_joints(await cell.robot.joints())
    cell.arm.check_limits(cell.posture())
    await cell.poses.collect(["coil", "body_ref"], FRAMES_TO_LOCATE, timeout=5.0)
    run.outcome = clear_state(run)


def clear_state(run: Run) -> str:
    """``retracted`` where the tool is seen clear of the body, otherwise ``held``."""
    clearance = run.cell.settings.placement.clearance
    try:
        distance = distance_from_body(run.cell, run.data)
    except RefusalError:
        return "held"
    run.result |= {"distance": distance, "clearance": clearance}
    return "retracted" if distance > clearance else "held"


def register_connection_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these steps."""
    for step in (connect_robot, disconnect_robot, locate_arm):
        registry.world_step(step)
