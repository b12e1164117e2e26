"""`pcmrs session`: whole sessions on the simulated cell, and their result folders."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import json_option, refuse_given
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run
from pcmrs.cli.tables import print_report
from pcmrs.cli.values import POSITIVE, Finite
from pcmrs_lab.cli.experiment_options import DEFAULT_RATE

if TYPE_CHECKING:
    # For annotations only: --help must not load the experiments.
    from rich.table import Table

    from pcmrs_lab.experiment.threshold_session import SessionSummary

EXIT_INTERRUPTED = 130


@click.group()
def session() -> None:
    """Run whole sessions on the simulated cell."""


@session.command("ratms-threshold")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of subject and errors.")
@click.option(
    "--rate", type=POSITIVE, default=DEFAULT_RATE, show_default=True, help="Speed of the simulation against real time."
)
@click.option(
    "--method",
    type=click.Choice(["adaptive", "grid"]),
    default="adaptive",
    show_default=True,
    help="Method of the hot-spot search.",
)
@click.option(
    "--threshold",
    type=click.Choice(["ml", "relative_frequency"]),
    default="ml",
    show_default=True,
    help="Method of the threshold estimation: maximum likelihood, or 5 of 10.",
)
@click.option(
    "--budget",
    type=click.IntRange(1, 500),
    help="Largest number of pulses of an adaptive search; by default procedure.stimulation.hotspot.max_pulses.",
)
@click.option(
    "--ceiling",
    type=Finite(20.0, 100.0),
    default=90.0,
    show_default=True,
    help="Highest allowed intensity, percent of the maximum stimulator output.",
)
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the results, empty or new; by default sessions/DATE-SUBJECT-SEED.",
)
@click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Set one value of the daemon's configuration."
)
@json_option
@readable_errors
def ratms_threshold(
    seed: int,
    rate: float,
    method: str,
    threshold: str,
    budget: int | None,
    ceiling: float,
    output: Path | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Register, place the coil, find hot-spot and motor threshold, and write the session's folder.

    The folder contains journal, configuration, tables of all pulses and responses, the signals, pictures, report.html
    and the hashes of all files. Ctrl-C ends the session: the data up to then are written, and marked as incomplete.

    Example: pcmrs session ratms-threshold --seed 3 --output session3

    Exit status 1: the session ended early, for example without a threshold; 130 after Ctrl-C.
    """
    from pcmrs.testing.plan import example_plan, read_plan
    from pcmrs_lab.experiment.session.setup import SessionSetup
    from pcmrs_lab.experiment.threshold_session import INTERRUPTED, run_threshold_session

    if method == "grid":
        refuse_given(["budget"], "is the budget of an adaptive search: a grid is always measured completely.")
    setup = SessionSetup(
        plan=read_plan(example_plan("ratms")),
        seed=seed,
        rate=rate,
        method="grid" if method == "grid" else "adaptive",
        threshold="ml" if threshold == "ml" else "relative_frequency",
        budget=budget,
        ceiling=ceiling,
        overrides=overrides,
    )
    folder = output or _default_folder(setup.configuration.procedure.patient, seed)
    with progress_bar() as progress:
        report = run(run_threshold_session(setup, folder, progress))
    print_report(report, session_table(report), as_json=as_json)
    if report.ended:
        raise SystemExit(EXIT_INTERRUPTED if report.ended == INTERRUPTED else EXIT_REJECTED)


def session_table(report: SessionSummary) -> Table:
    """Return a table of the session's results."""
    from rich.table import Table

    table = Table(title="Hot-spot and motor threshold, simulated", show_header=False)
    table.add_column(style="dim")
    table.add_column()
    for name, text in _lines(report):
        table.add_row(name, text)
    return table


def _lines(report: SessionSummary) -> list[tuple[str, str]]:
    pulses = f"{report.pulses}: {report.hotspot_pulses} for the hot-spot, {report.threshold_pulses} for the threshold"
    lines = [
        ("folder", report.folder),
        ("registration", _number(report.residual_mm, ".2f", " mm residual")),
        ("placements", f"{report.placements}, mean error {_number(report.placement_error_mm, '.3f', ' mm')}"),
        ("pulses", pulses),
        ("hot-spot", _hotspot(report)),
        ("threshold", _threshold(report)),
    ]
    return [*lines, ("ended early", report.ended)] if report.ended else lines


def _hotspot(report: SessionSummary) -> str:
    if report.hotspot_mm is None:
        return "not found"
    place = ", ".join(f"{value:.1f}" for value in report.hotspot_mm)
    known = _number(report.hotspot_uncertainty_mm, ".1f", " mm rms")
    return f"({place}) mm, known within {known}; {_number(report.hotspot_error_mm, '.1f', ' mm')} from the true one"


def _threshold(report: SessionSummary) -> str:
    if report.threshold is None:
        return "not found"
    low, high = report.threshold_low, report.threshold_high
    interval = "" if low is None or high is None else f", 95 % interval {low:g} % to {high:g} %"
    return f"{report.threshold:g} %{interval}; {_number(report.threshold_error, '+.1f', ' %')} off the true one"


def _number(value: float | None, form: str, unit: str) -> str:
    return "–" if value is None else f"{value:{form}}{unit}"


def _default_folder(subject: str, seed: int) -> Path:
    today = datetime.datetime.now(datetime.UTC).date()
    return Path("sessions") / f"{today.isoformat()}-{subject}-{seed}"
