"""`pcmrs calibrate tip`: contact point and axes of the tool in its marker body."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
import numpy as np

from pcmrs.cli.calibrate.options import ResultOptions, result_options
from pcmrs.cli.running import readable_errors
from pcmrs.cli.values import POSITIVE, Finite

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the numerics.
    from pcmrs.calibration import ToolType
    from pcmrs.calibration.poses import Touches
    from pcmrs.cli.calibrate.result import CalibrationResult
    from pcmrs.registration.tool_tip import ToolTip, TouchNoise

FILE = click.argument("file", type=click.Path(path_type=Path))
TYPE = click.option(
    "--type", "tool", type=click.Choice(["coil", "drill_guide"]), default="coil", show_default=True, help="Tool."
)
GUIDE = click.option(
    "--type", "tool", type=click.Choice(["coil", "drill_guide"]), default="drill_guide", show_default=True, help="Tool."
)
LIMIT = click.option(
    "--limit-mm", type=POSITIVE, default=1.0, show_default=True, help="Largest rms residual that is accepted."
)
POINTER = click.option(
    "--pointer", type=click.Path(path_type=Path), required=True, help="Calibration file of the pointer."
)
NOISE = click.option(
    "--noise-mm", type=POSITIVE, default=0.3, show_default=True, help="Least noise of a touch, sd per axis."
)
NOT_NEGATIVE = Finite(0.0)


@click.group()
def tip() -> None:
    """Find the contact point and the axes of the tool in its marker body, which the tracker sees.

    The frame of the contact point is the one that a plan places on the body; its +z points away from the body. Each way
    prints the predicted error of the contact point, which the predicted error at a target includes.
    """


@tip.command()
@FILE
@result_options
@POINTER
@TYPE
@LIMIT
@NOISE
@readable_errors
def points(options: ResultOptions, file: Path, pointer: Path, tool: ToolType, limit_mm: float, noise_mm: float) -> None:
    """Touch three or more known points of the tool with the pointer.

    FILE is CSV with tracker_from_tool_marker_x_m, …_y_m, …_z_m, …_qx, …_qy, …_qz, …_qw, the same for
    tracker_from_pointer, and the touched point as the maker's drawing has it: point_in_tool_tip_x_mm, …_y_mm, …_z_mm
    (or _m); or JSON with the same names.

    Example: pcmrs calibrate tip points touches.csv --pointer stylus.toml --name MC-B70 -o coil-tip.toml
    """
    from pcmrs.cli.calibrate.result import conclude
    from pcmrs.registration.tool_tip import tip_from_points

    def solve() -> CalibrationResult:
        touches, noise = _touches(options, file, pointer, noise_mm, noise_mm)
        found = tip_from_points(touches.known_in_tool_tip, touches.known_in_tool_marker, noise)
        return _result(found, tool, f"{len(found.distances)} known points", limit_mm)

    conclude(options, solve)


@tip.command()
@FILE
@result_options
@POINTER
@click.option("--mesh", type=click.Path(path_type=Path), required=True, help="Mesh of the tool: STL, PLY or OBJ.")
@click.option("--unit", type=click.Choice(["mm", "m"]), default="mm", show_default=True, help="Unit of the mesh.")
@click.option(
    "--surface-mm", type=POSITIVE, default=0.3, show_default=True, help="Noise of a touch along the normal, with mesh."
)
@TYPE
@LIMIT
@NOISE
@readable_errors
def mesh(
    options: ResultOptions,
    file: Path,
    pointer: Path,
    mesh: Path,
    unit: str,
    surface_mm: float,
    tool: ToolType,
    limit_mm: float,
    noise_mm: float,
) -> None:
    """Touch three known points of the tool, then 23 or more anywhere on its surface.

    FILE is that of pcmrs calibrate tip points; a row without point_in_tool_tip is a point of the surface. The mesh is
    in the frame of the contact point.

    Example: pcmrs calibrate tip mesh touches.csv --mesh coil.stl --pointer stylus.toml -o coil-tip.toml
    """
    from pcmrs.cli.calibrate.result import conclude
    from pcmrs.formats.grid import Unit
    from pcmrs.formats.mesh import read_mesh
    from pcmrs.registration.tool_tip import tip_from_mesh

    def solve() -> CalibrationResult:
        touches, noise = _touches(options, file, pointer, noise_mm, surface_mm)
        # A mesh of a tool has no anatomical axes: RAS leaves them as they are.
        surface = read_mesh(mesh, cast(Unit, unit), "RAS")
        known, touched = touches.known_in_tool_tip, touches.known_in_tool_marker
        others = touches.surface_in_tool_marker
        found = tip_from_mesh(known, touched, surface.vertices, surface.faces, others, noise)
        method = f"{len(found.distances)} known points and {len(others)} on the mesh"
        return _result(found, tool, method, limit_mm)

    conclude(options, solve)


@tip.command()
@FILE
@click.argument("end", type=click.Path(path_type=Path))
@result_options
@GUIDE
@LIMIT
@readable_errors
def pivot(options: ResultOptions, file: Path, end: Path, tool: ToolType, limit_mm: float) -> None:
    """Pivot a tool that is symmetric about its axis about both ends of the axis.

    FILE has poses while the tip rests in a divot, END poses while a point on the axis, far above the tip, rests in one:
    CSV with tracker_from_tool_marker_x_m, …_y_m, …_z_m, …_qx, …_qy, …_qz, …_qw (or _mm), or JSON with the same names.

    Example: pcmrs calibrate tip pivot tip.csv end.csv --name guide -o guide-tip.toml
    """
    from pcmrs.calibration.poses import TIP_PIVOT, read_poses
    from pcmrs.cli.calibrate.result import conclude
    from pcmrs.registration.tool_tip import tip_from_pivots

    def solve() -> CalibrationResult:
        (at_tip,), (at_end,) = read_poses(file, TIP_PIVOT), read_poses(end, TIP_PIVOT)
        found = tip_from_pivots(at_tip, at_end)
        used = len(found.distances) - len(found.bad)
        return _result(found, tool, f"pivots about both ends of the axis, {used} poses", limit_mm)

    conclude(options, solve)


@tip.command()
@result_options
@click.option("--position-mm", type=(Finite(), Finite(), Finite()), required=True, help="Contact point: x y z.")
@click.option(
    "--quat-wxyz", type=(Finite(), Finite(), Finite(), Finite()), required=True, help="Its axes: unit quaternion."
)
@click.option("--error-mm", type=NOT_NEGATIVE, required=True, help="Rms error of the position, as the maker states it.")
@click.option("--error-deg", type=NOT_NEGATIVE, required=True, help="Rms error of the axes, as the maker states it.")
@TYPE
@readable_errors
def values(
    options: ResultOptions,
    position_mm: tuple[float, float, float],
    quat_wxyz: tuple[float, float, float, float],
    error_mm: float,
    error_deg: float,
    tool: ToolType,
) -> None:
    """Take the values of the maker: contact point and axes in the marker body, and their errors.

    Example: pcmrs calibrate tip values --position-mm 0 0 -90 --quat-wxyz 1 0 0 0 --error-mm 0.3 --error-deg 0.2
    """
    from pcmrs.cli.calibrate.result import conclude
    from pcmrs.registration.tool_tip import ToolTip
    from pcmrs.spatial import Transform

    def solve() -> CalibrationResult:
        pose = Transform.from_quat_wxyz([value / 1000.0 for value in position_mm], quat_wxyz)
        found = ToolTip(pose, error_mm / 1000.0, float(np.radians(error_deg)), np.zeros(0), 0.0)
        return _result(found, tool, "values of the maker", 0.0)

    conclude(options, solve)


def _touches(
    options: ResultOptions, file: Path, pointer: Path, noise_mm: float, surface_mm: float
) -> tuple[Touches, TouchNoise]:
    """Return the touched points and their noise, which is at least the error of the pointer's tip.

    Raises:
        FileFormatError: A file cannot be read.
        RefusalError: The pointer's calibration must not be used here and now.
    """
    from pcmrs.calibration import ExpectedCalibration, check_valid, read_calibration
    from pcmrs.calibration.poses import read_touches
    from pcmrs.clock import SystemClock
    from pcmrs.errors import FileFormatError
    from pcmrs.registration.tool_tip import TouchNoise

    calibration = read_calibration(pointer)
    if calibration.kind != "pointer":
        raise FileFormatError(f"{pointer} is the calibration of a {calibration.kind}, not of a pointer.")
    here = ExpectedCalibration(f"{options.address.site}/{options.address.cell}", "coil")
    check_valid(calibration, here, SystemClock().wall())
    touches = read_touches(file, calibration.transform().translation)
    # The error in the file is the rms distance, over three axes.
    tip_mm = calibration.error_mm / np.sqrt(3.0)
    return touches, TouchNoise(max(noise_mm, tip_mm) / 1000.0, max(surface_mm, tip_mm) / 1000.0)


def _result(found: ToolTip, tool: ToolType, method: str, limit_mm: float) -> CalibrationResult:
    from pcmrs.cli.calibrate.result import CalibrationResult

    pose, error_mm, error_deg = found.tool_marker_from_tool_tip, found.error * 1000.0, np.degrees(found.angle_error)
    measured = len(found.distances) > 0
    at = "  ".join(f"{value * 1000:.3f}" for value in pose.translation)
    quat = " ".join(f"{value:.6f}" for value in pose.quat_wxyz)
    content: dict[str, Any] = {
        "tool_marker_from_tool_tip": {"position": pose.translation.tolist(), "quat_wxyz": pose.quat_wxyz.tolist()},
        "error": found.error,
        "angle_error": found.angle_error,
        "rms": found.rms,
        "distances": found.distances.tolist(),
        "bad": list(found.bad),
    }
    return CalibrationResult(
        kind="tip",
        tool=tool,
        method=method,
        values=content,
        summary=[
            f"contact point in the marker body, x y z in mm: {at}",
            f"its axes as a quaternion w x y z: {quat}",
            f"predicted rms error: {error_mm:.3f} mm, {error_deg:.3f}°",
        ],
        residuals={"mm": found.distances * 1000.0} if measured else {},
        rms={"mm": found.rms * 1000.0} if measured else {},
        bad=found.bad,
        limits={"mm": limit_mm},
        transforms={"tool_marker_from_tool_tip": pose},
        errors={"mm": error_mm, "deg": float(error_deg)},
    )
