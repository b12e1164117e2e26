"""`pcmrs calibrate`: the tip of the pointer, the tool on the flange, and the contact point of the tool."""

from __future__ import annotations

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup

COMMANDS = {
    "pivot": LazyCommand(
        "pcmrs.cli.calibrate.pivot:pivot",
        "Find the tip of the pointer from poses taken while it rests on one point.",
    ),
    "hand-eye": LazyCommand(
        "pcmrs.cli.calibrate.hand_eye:hand_eye",
        "Find the tool's marker body on the flange from postures of the arm in which the tracker sees it.",
    ),
    "tip": LazyCommand(
        "pcmrs.cli.calibrate.tip:tip",
        "Find the contact point and the axes of the tool in its marker body, which the tracker sees.",
    ),
    "import": LazyCommand(
        "pcmrs.cli.calibrate.lab_import:lab_import",
        "Take over the calibrations and the last procedure in the YAML files of the lab's software (rotms-ros).",
    ),
}


@click.group(cls=LazyGroup, commands=COMMANDS)
def calibrate() -> None:
    """Calibrate the pointer or the tool from poses in a file, or with --live on a running cell.

    Prints the result, the deviation of every pose, and the poses that do not fit the others; -o writes a
    calibration file for procedure.calibration. Or import what the lab's software has calibrated. Exit status: 0 usable,
    1 refused (the poses do not determine it, or an error is over its limit), 5 unreadable, 3 no daemon.
    """
