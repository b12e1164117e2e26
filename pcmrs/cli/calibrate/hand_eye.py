"""`pcmrs calibrate hand-eye`: the tool's marker body on the flange, and the tracker beside the robot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from pcmrs.cli.calibrate.options import CalibrationRequest, calibration_options
from pcmrs.cli.running import readable_errors
from pcmrs.cli.values import POSITIVE

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the numerics.
    from pcmrs.calibration import ToolType
    from pcmrs.cli.calibrate.result import CalibrationResult
    from pcmrs.registration.hand_eye import HandEyeCalibration
    from pcmrs.spatial import Transform

POSES = 15


@click.command("hand-eye")
@calibration_options(POSES, fewest=6)
@click.option("--type", "tool", type=click.Choice(["coil", "drill_guide"]), default="coil", show_default=True)
@click.option("--robot", default="iiwa14", show_default=True, help="Model of the arm, for --live.")
@click.option(
    "--limit-mm", type=POSITIVE, default=2.0, show_default=True, help="Largest rms residual that is accepted."
)
@click.option("--limit-deg", type=POSITIVE, default=0.5, show_default=True, help="Largest rms rotation residual.")
@readable_errors
def hand_eye(request: CalibrationRequest, tool: ToolType, robot: str, limit_mm: float, limit_deg: float) -> None:
    """Find the tool's marker body on the flange from postures of the arm in which the tracker sees it.

    FILE is CSV with base_from_flange_x_m, …_y_m, …_z_m, …_qx, …_qy, …_qz, …_qw and the same for
    tracker_from_tool_marker (or _mm), or JSON with the same names. With --live, move the arm to other postures, by
    hand or by pcmrs call: every posture in which it rests is used while the tracker sees the tool and the reference,
    until the bar is full.

    Example: pcmrs calibrate hand-eye poses.csv --name MC-B70 --type coil -o coil.toml
    """
    from pcmrs.cli.calibrate.result import conclude

    conclude(request, lambda: _solve(*_poses(request, robot), tool, {"mm": limit_mm, "deg": limit_deg}))


def _poses(request: CalibrationRequest, robot: str) -> tuple[list[Transform], list[Transform]]:
    from pcmrs.calibration.poses import HAND_EYE, read_poses
    from pcmrs.cli.calibrate.live import hand_eye_poses, save_poses
    from pcmrs.cli.running import run

    if isinstance(request.source, Path):
        flange, coil = read_poses(request.source, HAND_EYE)
        return flange, coil
    flange, coil = run(hand_eye_poses(request.address, request.source, robot))
    save_poses(request.source, HAND_EYE, [flange, coil])
    return flange, coil


def _solve(
    flange: list[Transform], coil: list[Transform], tool: ToolType, limits: dict[str, float]
) -> CalibrationResult:
    from pcmrs.cli.calibrate.result import CalibrationResult
    from pcmrs.registration.hand_eye import calibrate_hand_eye

    found = calibrate_hand_eye(flange, coil)
    return CalibrationResult(
        kind="tool",
        tool=tool,
        method=f"hand-eye and robot-world (Shah 2013, refined), {len(flange) - len(found.bad)} poses",
        values=_values(found),
        summary=_summary(found),
        residuals={"mm": found.distances * 1000.0, "deg": np.degrees(found.angles)},
        rms={"mm": found.rms * 1000.0, "deg": float(np.degrees(found.rms_angle))},
        bad=found.bad,
        limits=limits,
        transforms={
            "flange_from_tool_marker": found.flange_from_tool_marker,
            "base_from_tracker": found.base_from_tracker,
        },
    )


def _values(found: HandEyeCalibration) -> dict[str, object]:
    return {
        **{
            name: {"position": pose.translation.tolist(), "quat_wxyz": pose.quat_wxyz.tolist()}
            for name, pose in (
                ("flange_from_tool_marker", found.flange_from_tool_marker),
                ("base_from_tracker", found.base_from_tracker),
            )
        },
        "deviations": found.deviations.tolist(),
        "covariance": found.covariance.tolist(),
        "rms": found.rms,
        "rms_angle": found.rms_angle,
        "distances": found.distances.tolist(),
        "angles": found.angles.tolist(),
        "bad": list(found.bad),
        "singular_values": found.singular_values.tolist(),
    }


def _summary(found: HandEyeCalibration) -> list[str]:
    at = "  ".join(
        f"{value * 1000:.3f} ± {sd * 1000:.3f}"
        for value, sd in zip(found.flange_from_tool_marker.translation, found.deviations[3:], strict=True)
    )
    quat = " ".join(f"{value:.6f}" for value in found.flange_from_tool_marker.quat_wxyz)
    turn = "  ".join(f"{np.degrees(sd):.4f}" for sd in found.deviations[:3])
    tracker = " ".join(f"{value * 1000:.2f}" for value in found.base_from_tracker.translation)
    turned = ", ".join(f"{np.degrees(value):.1f}°" for value in found.singular_values)
    return [
        f"marker body on the flange, x y z in mm, ± 1 sd: {at}",
        f"its quaternion w x y z: {quat}; sd about x y z in °: {turn}",
        f"tracker in the robot's base, x y z in mm: {tracker}",
        f"rms rotation of the flange about its axes: {turned}",
    ]
