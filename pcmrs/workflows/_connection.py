"""Connection of the robot, its first location, and the check of the calibrations.

Nothing is measured or moved with a calibration that is expired, changed, or made for another tool or pointer.
"""

from __future__ import annotations

import numpy as np

from pcmrs.calibration import ExpectedCalibration, check_valid
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.workflows._paths import distance_from_body
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

Run = AnyRun[Cell, PlacementData]

FRAMES_TO_LOCATE = 5
"""Number of tracker frames that must show the tool and the body before the arm is located."""


def calibration_valid(run: Run) -> None:
    """Refuse if a configured calibration file must not be used. Poses in the configuration do not expire.

    Raises:
        RefusalError: A calibration of tool or pointer is not valid; see `check_valid`.
    """
    cell, settings = run.cell, run.cell.settings
    run.result["calibration"] = cell.calibrations()
    tool, pointer = settings.calibration.tool_serial, settings.calibration.pointer_serial
    serials = {"tool": tool, "tip": tool, "pointer": pointer}
    for kind, calibration in cell.mounting.files.items():
        check_valid(calibration, ExpectedCalibration(cell.name, settings.tool, serials[kind]), run.clock.wall())


async def connect_robot(run: Run) -> None:
    """Connect the robot. It is connected once it has reported joints within its limits.

    From then on the devices may act, unless Stop is latched. In that case only its acknowledgement releases them.
    """
    state = await run.cell.robot.connect()
    if not np.all(np.isfinite(state.positions)):
        raise RefusalError("bad_joints", f"The robot reports joints {state.positions}, which are not finite numbers.")
    run.cell.arm.check_limits(state.positions)
    run.cell.update_joints(state)
    if not run.latched and (latched := await run.cell.release(stopped=True)):
        run.result["still_latched"] = latched
    run.post("placement", "locate")


async def disconnect_robot(run: Run) -> None:
    """End the connection after the robot has confirmed it."""
    await run.cell.robot.disconnect()


async def locate_arm(run: Run) -> None:
    """Decide by the measured joints and the tracked body if the tool is clear of the body."""
    cell = run.cell
    cell.update_joints(await cell.robot.joints())
    cell.arm.check_limits(cell.posture())
    await cell.poses.collect(["coil", "body_ref"], FRAMES_TO_LOCATE, timeout=5.0)
    run.outcome = clear_state(run)


def clear_state(run: Run) -> str:
    """Return ``retracted`` if the tool is seen clear of the body, otherwise ``held``; the result says why."""
    clearance = run.cell.settings.placement.clearance
    try:
        distance = distance_from_body(run.cell, run.data)
    except RefusalError as error:
        run.result["not_seen"] = error.text
        return "held"
    run.result |= {"distance": distance, "clearance": clearance}
    return "retracted" if distance > clearance else "held"


def register_connection_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for this check and these steps."""
    registry.check(calibration_valid)
    for step in (connect_robot, disconnect_robot, locate_arm):
        registry.world_step(step)
