"""Closed loop of a placement: the tracker corrects the command until the tool is at its target."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.spatial import Floats, Transform, mean_transform
from pcmrs.workflows._collision_checks import plan_linear_path
from pcmrs.workflows._motion import follow, measure_frames
from pcmrs.workflows._placement import kept_nudges, target_pose
from pcmrs.workflows._tracker_noise import Tolerance
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.settings import PlacementSettings

Run = AnyRun[Cell, PlacementData]

CORRECTION_TIME = 2.0
"""Limit to plan one correction, s of the machine. It takes some 10 ms, and rests on what was just measured."""


@dataclass(frozen=True, slots=True)
class CorrectionLine:
    """Straight line by which the tool is corrected.

    Attributes:
        start: Commanded joint positions at its start, rad, (n,).
        base_from_tool_tip: Pose of the tool to command at its end, in the robot's base.
    """

    start: Floats
    base_from_tool_tip: Transform


async def correct_from_tracker(run: Run) -> None:
    """Correct the command by the tracker until the tool is within tolerance.

    The arm's error hardly changes over so small a distance. Each round measures at rest and moves the command, not the
    measured pose, by the remaining error. The result holds all rounds, the tracker's noise in the last one, and the
    tolerance that follows from it.

    Raises:
        RefusalError: A correction is implausibly large or was not planned in time, what it rests on has changed
            meanwhile, or the rounds do not bring the tool within tolerance.
    """
    cell, limits = run.cell, run.cell.settings.placement
    commanded = run.prepared.positions[-1]
    rounds: list[dict[str, float]] = []
    run.result["corrections"] = rounds
    while True:
        frames = await measure_frames(run)
        tolerance = Tolerance.by_noise(frames, limits)
        run.result["tolerance"] = tolerance.as_result()
        image_from_measured = mean_transform(frames)
        measured_from_desired = image_from_measured.inverse() @ target_pose(kept_nudges(run), limits.confirm_offset)
        shift_mm, turn_deg = size_mm_deg(measured_from_desired)
        rounds.append({"shift_mm": shift_mm, "turn_deg": turn_deg})
        check_correctable(measured_from_desired, limits)
        if _converged(rounds, tolerance, limits.corrections):
            return
        goal = cell.arm.forward(commanded) @ cell.flange_from_tool_tip @ measured_from_desired
        run.prepared = CorrectionLine(commanded, goal)
        await run.plan(correction_possible, within=CORRECTION_TIME)
        await follow(run, run.prepared)
        commanded = run.prepared.positions[-1]


def correction_possible(run: Run) -> None:
    """Plan the line of one correction, which `run.prepared` holds."""
    line: CorrectionLine = run.prepared
    run.prepared = plan_linear_path(run, line.start, line.base_from_tool_tip, near=True)


def check_correctable(measured_from_desired: Transform, limits: PlacementSettings) -> None:
    """Refuse an implausibly large correction.

    Args:
        measured_from_desired: Desired pose of the tool in its measured frame.
        limits: Settings with the limits.

    Raises:
        RefusalError: ``correction_too_large``.
    """
    shift_mm, turn_deg = size_mm_deg(measured_from_desired)
    if shift_mm > limits.correction_limit_mm or turn_deg > limits.correction_limit_deg:
        text = (
            f"The tracker sees the tool {_size_text(shift_mm, turn_deg)} from where it should be; the limits are "
            f"{limits.correction_limit_mm:g} mm and {limits.correction_limit_deg:g}°. Check the calibration, and "
            "whether the body has moved."
        )
        raise RefusalError("correction_too_large", text, shift_mm=shift_mm, turn_deg=turn_deg)


def size_mm_deg(measured_from_desired: Transform) -> tuple[float, float]:
    """Return the translation of a transform in mm and its rotation in deg."""
    shift, turn = np.linalg.norm(measured_from_desired.translation), np.linalg.norm(measured_from_desired.rotvec)
    return float(shift) * 1000.0, math.degrees(float(turn))


def _size_text(shift_mm: float, turn_deg: float) -> str:
    return f"{shift_mm:.2f} mm and {turn_deg:.2f}°"


def _converged(rounds: list[dict[str, float]], tolerance: Tolerance, corrections: int) -> bool:
    """Return True if the tool is within tolerance. Raises `RefusalError` if another round is not worthwhile."""
    # In the first round, both are the same.
    last, before = rounds[-1], rounds[-2:][0]
    if last["shift_mm"] <= tolerance.mm and last["turn_deg"] <= tolerance.deg:
        return True
    grows = last["shift_mm"] > before["shift_mm"] + tolerance.mm
    if grows or last["turn_deg"] > before["turn_deg"] + tolerance.deg or len(rounds) > corrections:
        text = (
            f"After {len(rounds) - 1} corrections the tracker sees the tool {_size_text(**last)} from where it should "
            f"be; {tolerance.text}. Check that the body keeps still, then back off."
        )
        raise RefusalError("not_converged", text, corrections=rounds, tolerance=tolerance.as_result())
    return False


def register_correction_steps(registry: Registry[Cell, PlacementData]) -> None:
    """Register the name that blueprints use for this step, and the check that the step asks."""
    registry.long_check(correction_possible)
    registry.world_step(correct_from_tracker, moves=True)
