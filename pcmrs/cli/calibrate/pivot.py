"""`pcmrs calibrate pivot`: position of the pointer's tip."""

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
    from pcmrs.cli.calibrate.result import CalibrationResult
    from pcmrs.spatial import Transform

POSES = 60


@click.command()
@calibration_options(POSES, fewest=10)
@click.option(
    "--limit-mm", type=POSITIVE, default=1.0, show_default=True, help="Largest rms residual that is accepted."
)
@readable_errors
def pivot(request: CalibrationRequest, limit_mm: float) -> None:
    """Find the tip of the pointer from poses taken while it rests on one point.

    FILE is CSV with the header tracker_from_pointer_x_m, …_y_m, …_z_m, …_qx, …_qy, …_qz, …_qw (or _mm), or JSON with
    the same names. With --live, hold the tip in a divot and tilt the pointer to all sides until the bar is full.

    Example: pcmrs calibrate pivot poses.csv --name stylus --serial 17 -o stylus.toml
    """
    from pcmrs.cli.calibrate.result import conclude

    conclude(request, lambda: _solve(_poses(request), limit_mm))


def _poses(request: CalibrationRequest) -> list[Transform]:
    from pcmrs.calibration.poses import PIVOT, read_poses
    from pcmrs.cli.calibrate.live import pivot_poses, save_poses
    from pcmrs.cli.running import run

    if isinstance(request.source, Path):
        return read_poses(request.source, PIVOT)[0]
    poses = run(pivot_poses(request.address, request.source))
    save_poses(request.source, PIVOT, [poses])
    return poses


def _solve(poses: list[Transform], limit_mm: float) -> CalibrationResult:
    from pcmrs.cli.calibrate.result import CalibrationResult
    from pcmrs.registration.pivot import calibrate_pivot
    from pcmrs.spatial import Transform

    found = calibrate_pivot(poses)
    tip_mm, sd_mm = found.tip_in_pointer * 1000.0, found.deviations * 1000.0
    tip = "  ".join(f"{value:.3f} ± {sd:.3f}" for value, sd in zip(tip_mm, sd_mm, strict=True))
    turned = ", ".join(f"{np.degrees(value):.1f}°" for value in found.singular_values)
    return CalibrationResult(
        kind="pointer",
        tool=None,
        method=f"pivot, algebraic one-step (Yaniv 2015), {len(poses) - len(found.bad)} poses",
        values={
            "tip_in_pointer": found.tip_in_pointer.tolist(),
            "deviations": found.deviations.tolist(),
            "covariance": found.covariance.tolist(),
            "pivot_in_tracker": found.pivot_in_tracker.tolist(),
            "rms": found.rms,
            "distances": found.distances.tolist(),
            "bad": list(found.bad),
            "singular_values": found.singular_values.tolist(),
        },
        summary=[f"tip in the pointer's frame, x y z in mm, ± 1 sd: {tip}", f"rms rotation about its axes: {turned}"],
        residuals={"mm": found.distances * 1000.0},
        rms={"mm": found.rms * 1000.0},
        bad=found.bad,
        limits={"mm": limit_mm},
        transforms={"pointer_from_tip": Transform(np.eye(3), found.tip_in_pointer)},
    )
