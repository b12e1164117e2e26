"""Pressing the tool gently on the body along its own axis."""

from __future__ import annotations

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import JointTrajectory, MotionResult, PressRequest
from pcmrs.spatial import Frame
from pcmrs.workflows._collision_checks import check_towards, plan_linear_path
from pcmrs.workflows._guard import guarded
from pcmrs.workflows._paths import along_axis
from pcmrs.workflows._placement import check_at_present_plan, check_nudges, nudge_transform, planned_pose
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_point
from pcmrs.workflows.settings import PressForce

Run = AnyRun[Cell, PlacementData]

MIN_TRAVEL = 0.001
"""Least travel of a press, m."""

ROUNDING = 1e-4
"""Distance by which a press stays above the depth limit, m, because the joints are measured."""

REFUSAL_TEXTS = {
    "no_contact": "The tool met nothing within {travel:.1f} mm. Plan or nudge it nearer to the body.",
    "travel_limit": "After {travel:.1f} mm the force was {force:.1f} N, not {asked:g} N. Check what gives way.",
    "timeout": "At the time limit the force was {force:.1f} N, not steadily {asked:g} N. Check the tool.",
    "force_limit": "The force on the tool exceeded the robot's limit, and the arm was held. Check the tool.",
}
"""Texts of the refusal of a press that failed, by the robot's reason."""


class PressArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `press`.

    Attributes:
        force: Force, N; None for the configured one.
    """

    force: PressForce | None = None


def press_possible(run: Run) -> None:
    """Prepare a press, or refuse it if its whole travel would pass a zone or exceed the limit of the nudges."""
    run.cell.check_streams("press with a force")
    check_at_present_plan(run.data)
    cell, contact = run.cell, run.cell.settings.contact
    base_from_target = cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.IMAGE) @ planned_pose(run.data)
    base_from_tool_tip = cell.arm.forward(cell.posture()) @ cell.flange_from_tool_tip
    travel = _allowed_travel(cell, float((base_from_target.inverse() @ base_from_tool_tip.translation)[2]))
    # The travel becomes a nudge afterwards, so its sum is checked in advance.
    check_nudges(run, _nudged_by(run.data, travel), run.data.nudge_rotation_zyx)
    path = plan_linear_path(run, cell.posture(), base_from_tool_tip @ along_axis(-travel), near=True)
    check_towards(cell, run.data, path, base_from_target)
    request = PressRequest(
        force=contact.force if run.payload.force is None else run.payload.force,
        direction_in_flange=as_point(-cell.flange_from_tool_tip.rotation[:, 2]),
        travel=travel,
        speed=contact.speed,
        timeout=contact.timeout,
    )
    run.prepared = request, path


async def press_gently(run: Run) -> None:
    """Press, and report the force and the travel.

    The travel becomes a nudge, so that the pressed pose is the new target.

    Raises:
        RefusalError: There was no contact, or the force was not reached or too large.
    """
    cell = run.cell
    request, path = run.prepared
    async with guarded(cell, path, towards_body=True):
        ended = await cell.robot.press(request)
    travel = _travel(cell, path, ended)
    run.result |= {"force": ended.force, "asked": request.force, "travel": travel}
    if ended.outcome != "done":
        raise _not_pressed(request, ended, travel)
    run.keep(nudge_translation=_nudged_by(run.data, travel))
    await run.clock.sleep(cell.settings.placement.settle_time)


def _allowed_travel(cell: Cell, height: float) -> float:
    """Return the travel that a tool `height` (m) above the target may make, m.

    It is the configured travel, or the distance to the depth limit if that is shorter.
    """
    contact, limit = cell.settings.contact, cell.settings.zones.depth_limit
    remaining = height + limit - ROUNDING
    if remaining < MIN_TRAVEL:
        text = (
            f"The tool is {-height * 1000:.1f} mm beyond the target, and may go no deeper than {limit * 1000:g} mm. "
            "Nudge it away from the body, or plan another pose."
        )
        raise RefusalError("too_deep", text, height=height, limit=limit)
    return min(contact.travel, remaining)


def _nudged_by(data: PlacementData, travel: float) -> Point:
    """Return the sum of nudges after travel towards the body along the axis of the nudged tool, m."""
    return as_point(nudge_transform(data.nudge_translation, data.nudge_rotation_zyx) @ np.array([0.0, 0.0, -travel]))


def _travel(cell: Cell, path: JointTrajectory, ended: MotionResult) -> float:
    """Return the travel of the tool along its axis towards the body, computed from the joints, m."""
    before = cell.arm.forward(path.positions[0]) @ cell.flange_from_tool_tip
    after = cell.arm.forward(ended.positions) @ cell.flange_from_tool_tip
    return -float((before.inverse() @ after.translation)[2])


def _not_pressed(request: PressRequest, ended: MotionResult, travel: float) -> RefusalError:
    force = 0.0 if ended.force is None else ended.force
    reason = ended.reason or "held"
    text = REFUSAL_TEXTS.get(reason, f"The press was stopped: {reason}.")
    message = text.format(travel=travel * 1000.0, force=force, asked=request.force)
    code = reason if reason in REFUSAL_TEXTS else "motion_stopped"
    return RefusalError(code, message, force=force, asked=request.force, travel=travel, limit=request.travel)


def register_contact_operations(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for pressing."""
    registry.payload("press", PressArguments)
    registry.long_check(press_possible)
    registry.world_step(press_gently, moves=True)
