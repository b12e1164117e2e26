"""`pcmrs faults fuzz`: millions of datagrams that are nearly commands."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors, run
from pcmrs_lab.cli.faults.options import minutes_option, print_findings, seed_option


@click.command()
@click.option(
    "--datagrams", type=click.IntRange(min=1), default=1_000_000, show_default=True, help="Number of datagrams."
)
@seed_option
@minutes_option
@json_option
@readable_errors
def fuzz(datagrams: int, seed: int, minutes: float | None, as_json: bool) -> None:
    """Send fuzzed datagrams to a daemon: it must not crash, change its state, or grow by 10 MB.

    Exit status 1: it crashed, changed, or grew.

    Example: pcmrs faults fuzz --datagrams 5000000 --minutes 10
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from pcmrs.clock import SystemClock
    from pcmrs_lab.campaign.fuzz import fuzz as fuzz_daemon

    with progress_bar() as progress, tempfile.TemporaryDirectory(prefix="pcmrs-fuzz-") as folder:
        work = fuzz_daemon(datagrams, seed, Path(folder), SystemClock(), minutes=minutes, progress=progress)
        report = run(work)
    table = Table("", "", box=SIMPLE_HEAD, title="Fuzzed datagrams at the planner's link")
    table.add_row("sent, and dropped by the kernel", f"{report.datagrams} and {report.dropped}")
    table.add_row("answers", str(report.answers))
    table.add_row("per second", f"{report.rate:.0f}")
    table.add_row("crashed", "yes" if report.crashed else "no")
    table.add_row("state changed, commands in the journal", f"{'yes' if report.state_changed else 'no'}, {report.rows}")
    table.add_row("growth", f"{report.growth_mb:.1f} MB")
    print_findings([report], [report.violated], table, as_json=as_json)
