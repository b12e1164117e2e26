"""`pcmrs calibrate import`: calibrations and the last procedure from the YAML files of the lab's software."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say_json, say_lines
from pcmrs.cli.running import readable_errors
from pcmrs.cli.values import Finite

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the numerics.
    from pcmrs.calibration import Calibration, Kind, ToolType
    from pcmrs.calibration.lab_frames import LabCalibrations
    from pcmrs.formats.lab_files import LabProcedure
    from pcmrs.spatial import Transform

NOT_NEGATIVE = Finite(0.0)
MM_AND_DEG = (NOT_NEGATIVE, NOT_NEGATIVE)
FILES: dict[Kind, str] = {"tool": "tool.toml", "tip": "tip.toml", "pointer": "pointer.toml"}
CELL, PLAN, DIGITIZED, SURFACE, REGISTRATION = (
    "cell.toml",
    "plan.json",
    "digitized.csv",
    "surface.csv",
    "registration.yaml",
)
FARTHEST_MM = 20.0
"""Mean distance of the landmarks, mm, beyond which registration and landmarks are of two sessions."""


@click.command("import")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder, new or empty."
)
@click.option("--tool-error", type=MM_AND_DEG, required=True, help="Error of toolref_eff, rms: mm and °.")
@click.option("--tip-error", type=MM_AND_DEG, required=True, help="Error of tool_toolref, rms: mm and °.")
@click.option("--pointer-error", type=NOT_NEGATIVE, required=True, help="Error of ptr_ptrtip, rms: mm.")
@click.option(
    "--date", type=click.DateTime(["%Y-%m-%d"]), required=True, help="Day on which the oldest of them was made (UTC)."
)
@click.option(
    "--identity-in",
    "identities",
    type=click.Choice(["tool_toolref.yaml", "toolref_eff.yaml", "ptr_ptrtip.yaml"]),
    multiple=True,
    help="File in which the identity is meant; may be repeated.",
)
@click.option("--calibration-only", is_flag=True, help="Leave out landmarks, registration, tool pose and points.")
@click.option(
    "--type", "tool", type=click.Choice(["coil", "drill_guide"]), default="coil", show_default=True, help="Tool."
)
@click.option("--name", default="tool", show_default=True, help="Name of the tool.")
@click.option("--serial", default="", help="Serial number of the tool.")
@click.option("--pointer-name", default="pointer", show_default=True, help="Name of the pointer.")
@click.option("--pointer-serial", default="", help="Serial number of the pointer.")
@click.option("--valid-days", type=click.IntRange(1, 36500), default=180, show_default=True, help="Until expiry.")
@click.option("--site", default="lab", envvar="PCMRS_SITE", show_default=True, help="Site of the cell.")
@click.option("--cell", default="cell1", envvar="PCMRS_CELL", show_default=True, help="Name of the cell.")
@click.option("--any-cell", is_flag=True, help="Usable in any cell, not only in --site and --cell.")
@json_option
@readable_errors
def lab_import(folder: Path, output: Path, as_json: bool, **given: Any) -> None:
    """Take over the calibrations and the last procedure in the YAML files of the lab's software (rotms-ros).

    FOLDER is a checkout of it, or any folder with tool_toolref, toolref_eff, ptr_ptrtip, offset_tool and cntct_offset
    (.yaml); landmarkplan, landmarkdig, reg, toolpose and icpdig are taken as well if they are there. The lab's files
    have no errors and no date, so you have to give them. All files are checked before any is written.

    The output folder gets tool.toml, tip.toml and pointer.toml, cell.toml to start a cell with them, and plan.json,
    digitized.csv, surface.csv and registration.yaml. A registration is for comparison only: a cell registers again.

    Exit status: 0 imported, 5 a file is missing, ambiguous or wrong, 4 the output folder is not empty.

    Example: pcmrs calibrate import ~/rotms_ws/src --tool-error 0.5 0.2 --tip-error 0.4 0.2 --pointer-error 0.3 --date
    2026-10-01 -o calibration
    """
    from pcmrs.calibration import write_calibration
    from pcmrs.calibration.lab_frames import read_lab_calibrations
    from pcmrs.files import whole_folder
    from pcmrs.formats.lab_files import CALIBRATIONS, PROCEDURE, LabProcedure, find_lab_files, read_lab_procedure

    made = given["date"].replace(tzinfo=UTC)
    _check_past(made)
    found = find_lab_files(folder, CALIBRATIONS if given["calibration_only"] else (*CALIBRATIONS, *PROCEDURE))
    calibrations = read_lab_calibrations(found, given["identities"])
    procedure = LabProcedure() if given["calibration_only"] else read_lab_procedure(found)
    distance_mm = _landmark_distance_mm(found, procedure)
    files = _calibration_files(calibrations, made, given)
    texts = _texts(calibrations, procedure, given)
    with whole_folder(output) as part:
        for kind, name in FILES.items():
            write_calibration(part / name, files[kind])
        for name, text in texts.items():
            (part / name).write_text(text, "utf-8")
    names = [*FILES.values(), *texts]
    if as_json:
        read = {name: str(path) for name, path in sorted(found.items())}
        say_json({"folder": str(output), "files": names, "read": read, "landmark_distance_mm": distance_mm})
        return
    say_lines(f"read {path}" for _, path in sorted(found.items()))
    say_lines(_summary(calibrations, procedure, distance_mm))
    say_lines([f"written: {', '.join(names)} in {output}"])


def _check_past(made: datetime) -> None:
    from pcmrs.clock import SystemClock

    if made.timestamp() > SystemClock().wall():
        text = f"--date {made:%Y-%m-%d} is in the future: give the day on which the calibrations were made."
        raise click.UsageError(text)


def _landmark_distance_mm(found: dict[str, Path], procedure: LabProcedure) -> float | None:
    """Return the mean distance of the landmarks under the registration; None without both.

    Raises:
        FileFormatError: It is so large that they are of two sessions.
    """
    import numpy as np

    from pcmrs.formats.lab_files import REGISTRATION as REG
    from pcmrs.formats.reading import refuse

    if procedure.registration is None or not (procedure.planned and procedure.digitized):
        return None
    mapped = [procedure.registration @ np.array(point) for point in procedure.planned]
    distances = np.linalg.norm(np.array(mapped) - np.array(procedure.digitized, dtype=float), axis=1)
    mean = float(distances.mean() * 1000.0)
    if mean > FARTHEST_MM:
        text = (
            f"brings the planned landmarks to {mean:.1f} mm from the digitized ones on average, the limit is "
            f"{FARTHEST_MM:g} mm: the files are of two sessions. Give files of one session, or --calibration-only."
        )
        refuse(found[REG], text, value=mean, limit=FARTHEST_MM)
    return mean


def _calibration_files(found: LabCalibrations, made: datetime, given: dict[str, Any]) -> dict[Kind, Calibration]:
    from pcmrs.calibration import Calibration
    from pcmrs.workflows.data import as_message

    tool: ToolType = given["tool"]
    common = {
        "cell": "" if given["any_cell"] else f"{given['site']}/{given['cell']}",
        "date": made,
        "valid_days": given["valid_days"],
    }
    of_tool = {"type": tool, "name": given["name"], "serial": given["serial"], **common}
    of_pointer = {"name": given["pointer_name"], "serial": given["pointer_serial"], **common}
    return {
        "tool": Calibration(
            kind="tool",
            method="imported from toolref_eff.yaml of the lab's software",
            error_mm=given["tool_error"][0],
            error_deg=given["tool_error"][1],
            transforms={"flange_from_tool_marker": as_message(found.flange_from_tool_marker)},
            **of_tool,
        ),
        "tip": Calibration(
            kind="tip",
            method="imported from tool_toolref.yaml and offset_tool.yaml of the lab's software",
            error_mm=given["tip_error"][0],
            error_deg=given["tip_error"][1],
            transforms={"tool_marker_from_tool_tip": as_message(found.tool_marker_from_tool_tip)},
            **of_tool,
        ),
        "pointer": Calibration(
            kind="pointer",
            method="imported from ptr_ptrtip.yaml of the lab's software",
            error_mm=given["pointer_error"],
            transforms={"pointer_from_tip": as_message(found.pointer_from_tip)},
            **of_pointer,
        ),
    }


def _texts(calibrations: LabCalibrations, procedure: LabProcedure, given: dict[str, Any]) -> dict[str, str]:
    """Return the texts of the other files, by their names."""
    import json

    import tomli_w

    from pcmrs.formats.lab_text import lab_registration

    serials = {"tool_serial": given["serial"], "pointer_serial": given["pointer_serial"]}
    tables = {
        "procedure": {
            "calibration": {f"{kind}_file": name for kind, name in FILES.items()}
            | {key: value for key, value in serials.items() if value},
            "placement": {"standoff": calibrations.standoff},
        }
    }
    heading = "# Made by `pcmrs calibrate import`: the keys that a cell with these files needs.\n"
    found = {CELL: heading + tomli_w.dumps(tables)}
    if procedure.planned or procedure.tool_pose is not None:
        landmarks = [{"name": f"p{index}", "position": list(point)} for index, point in enumerate(procedure.planned)]
        poses = [] if procedure.tool_pose is None else [_as_plan(procedure.tool_pose)]
        found[PLAN] = json.dumps({"landmarks": landmarks, "poses": poses}, indent=2) + "\n"
    if procedure.digitized:
        found[DIGITIZED] = _csv("p", procedure.digitized)
    if procedure.surface:
        found[SURFACE] = _csv("s", procedure.surface)
    if procedure.registration is not None:
        found[REGISTRATION] = lab_registration(procedure.registration, refined=procedure.refined)
    return found


def _as_plan(pose: Transform) -> dict[str, list[float]]:
    return {"position": pose.translation.tolist(), "quat_xyzw": pose.quat_xyzw.tolist()}


def _csv(prefix: str, points: tuple[tuple[float, float, float] | None, ...]) -> str:
    rows = (
        f"{prefix}{index},{','.join(f'{value:.16g}' for value in point or ())}" for index, point in enumerate(points)
    )
    return "\n".join(["name,x_m,y_m,z_m", *rows]) + "\n"


def _summary(found: LabCalibrations, procedure: LabProcedure, distance_mm: float | None) -> list[str]:
    named = {
        "marker body on the flange (flange_from_tool_marker)": found.flange_from_tool_marker,
        "contact point in the marker body (tool_marker_from_tool_tip)": found.tool_marker_from_tool_tip,
        "tip in the pointer (pointer_from_tip)": found.pointer_from_tip,
    }
    lines = [
        f"{name}, x y z in mm: {'  '.join(f'{value * 1000.0:.3f}' for value in pose.translation)}; "
        f"quaternion w x y z: {' '.join(f'{value:.6f}' for value in pose.quat_wxyz)}"
        for name, pose in named.items()
    ]
    lines.append(f"standoff: {found.standoff * 1000.0:.1f} mm")
    counts = f"{len(procedure.planned)} planned and {len(procedure.digitized)} digitized landmarks"
    lines.append(f"{counts}, {len(procedure.surface)} points of the surface")
    if distance_mm is not None:
        lines.append(f"the lab's registration brings the landmarks together within {distance_mm:.2f} mm on average")
    return lines
