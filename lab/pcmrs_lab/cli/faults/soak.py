"""`pcmrs faults soak`: random but legal operation for hours."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from pcmrs.cli.options import json_option, plot_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.values import POSITIVE
from pcmrs_lab.cli.faults.options import print_findings, seed_option


@click.command()
@click.option("--hours", type=POSITIVE, default=1.0, show_default=True, help="Duration, h.")
@seed_option
@plot_option
@json_option
@readable_errors
def soak(hours: float, seed: int, plot: Path | None, as_json: bool) -> None:
    """Operate a simulated cell at random for hours: memory, file descriptors, threads and tasks must stay flat.

    Exit status 1: a measure grows, or the daemon ended.

    Example: pcmrs faults soak --hours 8 --plot soak.png
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from pcmrs.clock import SystemClock
    from pcmrs_lab.campaign.soaking import soak as soak_cell

    with progress_bar() as progress, tempfile.TemporaryDirectory(prefix="pcmrs-soak-") as folder:
        report = run(soak_cell(hours, seed, Path(folder), SystemClock(), progress=progress))
    if plot is not None:
        from pcmrs_lab.campaign.soak_plot import draw_soak

        draw_soak(report, plot)
    title = f"{report.steps} commands, {report.stops} of them Stop, in {report.seconds / 3600:.2f} h. "
    title += report.ended
    table = Table("process", "measure", "first", "last", "rise of its line", "", box=SIMPLE_HEAD, title=title)
    for trend in report.courses:
        scale = 1e6 if trend.measure == "memory" else 1.0
        unit = " MB" if trend.measure == "memory" else ""
        numbers = (trend.values[0], trend.values[-1], trend.rise)
        shown = [f"{number / scale:.1f}{unit}" for number in numbers]
        table.add_row(trend.process, trend.measure, *shown, "flat" if trend.flat else "GROWS")
    print_findings([report], [report.violated], table, as_json=as_json)
