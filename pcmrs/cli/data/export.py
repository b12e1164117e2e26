"""`pcmrs data export`: calibrations and the last procedure as the files of other software."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the numerics.
    from collections.abc import Sequence
    from datetime import datetime

    from pcmrs.formats.lab_files import LabProcedure
    from pcmrs.journal import JournalRow
    from pcmrs.report.session_journal import SessionJournal


FIELDS = {"landmarks", "previous", "previous_digitization", "previous_plan", "surface"}
"""Fields of the procedure data that are exported."""


@click.command()
@click.option("--format", "form", type=click.Choice(["rotms"]), required=True, help="Software that reads the files.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@json_option
@config_options
@readable_errors
def export(form: str, folder: Path, as_json: bool, file: Path | None, overrides: tuple[str, ...]) -> None:
    """Write the calibrations and the last procedure of the configured cell as the files of other software.

    The only format is rotms, the YAML files of the lab's software: tool_toolref, toolref_eff, ptr_ptrtip, offset_tool
    and cntct_offset from the configuration; landmarkplan, landmarkdig, reg, toolpose and icpdig from the journal, as
    the last accepted registration and plan have them. FOLDER must be new or empty. The cell may be running.

    Exit status: 0 exported, 5 the journal cannot be read, 4 the configuration cannot be used, or FOLDER is not empty.

    Example: pcmrs data export --format rotms rotms-files
    """
    from datetime import datetime

    from pcmrs.calibration.lab_frames import LabCalibrations, lab_calibrations_of
    from pcmrs.files import whole_folder
    from pcmrs.formats.lab_files import LabProcedure, procedure_texts
    from pcmrs.formats.lab_text import lab_calibration
    from pcmrs.report.session_journal import SessionJournal
    from pcmrs.settings import read_settings
    from pcmrs.workflows import read_workflow
    from pcmrs.workflows.mounting import Mounting

    settings = read_settings(file, overrides)
    mounting = Mounting.read(settings.procedure.calibration)
    journal = settings.cell.stored_journal(read_workflow(settings.workflow).id)
    procedure, when = LabProcedure(), datetime.fromtimestamp(0)
    if journal.exists():
        procedure, when = _procedure(SessionJournal.read(journal))
    calibrations = LabCalibrations(
        mounting.flange_from_tool_marker,
        mounting.tool_marker_from_tool_tip,
        mounting.pointer_from_tip,
        settings.procedure.placement.standoff,
    )
    texts = {name: lab_calibration(pose) for name, pose in lab_calibrations_of(calibrations).items()}
    texts |= procedure_texts(procedure, when)
    with whole_folder(folder) as part:
        for name, text in texts.items():
            (part / name).write_text(text, "utf-8")
    if as_json:
        say_json({"folder": str(folder), "format": form, "files": sorted(texts)})
        return
    say(f"{len(texts)} files in {folder}: {', '.join(sorted(texts))}")
    if not journal.exists():
        say(f"{journal} is not there, so only the calibrations were exported.", err=True)


def _procedure(journal: SessionJournal) -> tuple[LabProcedure, datetime]:
    """Return the newest data of the last session that has any, and the time of the landmarks' plan.

    A registration brings its landmarks and digitization along: newer ones would be of another plan.
    """
    from datetime import datetime

    from pcmrs.formats.lab_files import LabProcedure
    from pcmrs.workflows.data import Digitized, Landmark, Planned, Point, Registered, as_transform

    rows = _of_last_session(journal)
    registered = _last(rows, "previous", Registered)
    digitization = _last(rows, "previous_digitization", Digitized)
    plan = _last(rows, "previous_plan", Planned)
    surface = _last(rows, "surface", tuple[Point, ...]) or ()
    if registered is not None:
        landmarks, points = registered.landmarks, registered.digitized
    elif digitization is not None:
        landmarks, points = digitization.landmarks, digitization.points
    else:
        landmarks, points = _last(rows, "landmarks", tuple[Landmark, ...]) or (), ()
    plans = (row for row in rows if _last([row], "landmarks", tuple[Landmark, ...]) == landmarks)
    planned_at = next((row.wall for row in plans), 0.0)
    procedure = LabProcedure(
        tuple(landmark.position for landmark in landmarks),
        points,
        None if registered is None else as_transform(registered.body_ref_from_image),
        registered is not None and bool(registered.covariance),
        None if plan is None else as_transform(plan.image_from_coil),
        surface,
    )
    return procedure, datetime.fromtimestamp(planned_at)


def _of_last_session(journal: SessionJournal) -> list[JournalRow]:
    """Return the rows with data of the last run of the daemon that has any: another may be of another patient."""
    rows = [stored.row for stored in journal.rows if stored.row.result and FIELDS & stored.row.result.keys()]
    return [row for row in rows if row.session_id == rows[-1].session_id]


def _last(rows: Sequence[JournalRow], field: str, kind: Any) -> Any:
    """Return the last value of a field that is not empty, as `kind`; None if there is none."""
    import msgspec

    results = (row.result for row in reversed(rows))
    value = next((result[field] for result in results if result and result.get(field)), None)
    return None if value is None else msgspec.convert(value, kind)
