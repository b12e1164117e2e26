"""`pcmrs placements`: errors of recorded placements, and the quality of the tracker in a pose log."""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import json_option, plot_option
from pcmrs.cli.running import readable_errors
from pcmrs.cli.tables import print_report
from pcmrs.cli.values import Finite

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the analysis.
    from pcmrs.analysis.placements import PlacementTrial

STANDOFF_MM = 10.0
"""Distance before the target at which the lab's placements are saved, mm."""


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@click.option(
    "--standoff-mm",
    type=Finite(-1000.0, 1000.0),
    help=f"Planned distance of the tool before the target, along its z axis; {STANDOFF_MM:g} for saved placements, "
    "by default the recorded one for a journal.",
)
@plot_option
@json_option
@readable_errors
def placements(path: Path, standoff_mm: float | None, plot: Path | None, as_json: bool) -> None:
    """Print the errors of recorded placements: measured against planned pose.

    PATH is a folder of saved placements (one YAML file per trial) or one such file, or the journal of a cell
    (*.sqlite). For a pose log (poses_*.csv), it prints jitter, frozen frames, dropouts, and the agreement of its
    rows.

    Example: pcmrs placements trials/ --standoff-mm 10 --plot errors.png

    Exit status 5 if a file cannot be read.
    """
    if _is_pose_log(path):
        if standoff_mm is not None:
            raise click.UsageError(f"--standoff-mm is for placements; {path} is a pose log.")
        _show_pose_log(path, plot, as_json=as_json)
    else:
        _show_placements(path, standoff_mm, plot, as_json=as_json)


def _is_journal(path: Path) -> bool:
    return _beginning(path).startswith(b"SQLite format 3\0")


def _is_pose_log(path: Path) -> bool:
    from pcmrs.formats.pose_log import ROWS

    return _beginning(path).removeprefix(codecs.BOM_UTF8).lstrip().startswith(tuple(f"{row},".encode() for row in ROWS))


def _beginning(path: Path) -> bytes:
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(100)


def _trials(path: Path, standoff_mm: float | None) -> list[PlacementTrial]:
    from pcmrs.analysis.placements import PlacementTrial
    from pcmrs.formats.pose_file import SUFFIXES, read_placements
    from pcmrs.formats.pose_log import ROWS
    from pcmrs.formats.reading import refuse
    from pcmrs.report.session_journal import read_placements as read_journal_placements

    if _is_journal(path):
        return read_journal_placements(path, standoff_mm)
    if path.is_file() and path.suffix not in SUFFIXES:
        refuse(
            path,
            f"is neither a saved placement ({', '.join(SUFFIXES)}) nor a journal nor a pose log of rows {ROWS[0]}, ….",
        )
    standoff = (STANDOFF_MM if standoff_mm is None else standoff_mm) / 1000.0
    return [PlacementTrial(placement, standoff) for placement in read_placements(path)]


def _show_placements(path: Path, standoff_mm: float | None, plot: Path | None, *, as_json: bool) -> None:
    from pcmrs.analysis.plots import placement_figure, save_png
    from pcmrs.cli.placement_reports import placements_report, placements_tables

    trials = _trials(path, standoff_mm)
    report = placements_report(path, trials)
    if plot is not None:
        save_png(placement_figure(trials, f"Placements in {path.resolve().name}"), plot)
    print_report(report, placements_tables(report), as_json=as_json)


def _show_pose_log(path: Path, plot: Path | None, *, as_json: bool) -> None:
    from pcmrs.analysis.plots import pose_log_figure, save_png
    from pcmrs.cli.placement_reports import pose_log_report, pose_log_table
    from pcmrs.formats.pose_log import read_pose_log

    log = read_pose_log(path)
    report = pose_log_report(path, log)
    if plot is not None:
        save_png(pose_log_figure(log), plot)
    print_report(report, pose_log_table(report), as_json=as_json)
