"""`pcmrs faults kill`: kill -9 of processes that write the journal."""

from __future__ import annotations

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors, run
from pcmrs_lab.cli.faults.options import minutes_option, print_findings, seed_option


@click.command()
@click.option(
    "--times", type=click.IntRange(min=0), default=500, show_default=True, help="Number of journal writers to kill."
)
@click.option(
    "--daemons",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Number of daemons to kill in operation.",
)
@seed_option
@minutes_option
@json_option
@readable_errors
def kill(times: int, daemons: int, seed: int, minutes: float | None, as_json: bool) -> None:
    """Kill processes with SIGKILL, at every failpoint and at random instants; nothing acknowledged may be lost.

    A process counts as killed at a failpoint if the failpoint itself has killed it. An armed process that did not reach
    its failpoint in time is killed, too, and counts as not reached. --minutes limits each of the two parts. Exit status
    1: an acknowledged row was lost, or a journal cannot be opened.

    Example: pcmrs faults kill --times 10000 --daemons 200
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from pcmrs.clock import SystemClock
    from pcmrs.failpoints import FAILPOINTS
    from pcmrs_lab.campaign.daemonkills import kill_daemons
    from pcmrs_lab.campaign.kills import kill_writers

    reports = []
    with progress_bar() as progress:
        if times:
            reports.append(kill_writers(times, seed, SystemClock(), minutes=minutes, progress=progress))
        if daemons:
            reports.append(run(kill_daemons(daemons, seed, SystemClock(), minutes=minutes, progress=progress)))
    columns = ("killed", "times", "at failpoints", "not reached", "acknowledged", "lost", "refused", "s")
    table = Table(*columns, box=SIMPLE_HEAD)
    for report in reports:
        at = sum(count for name, count in report.at.items() if name in FAILPOINTS)
        missed = sum(report.not_reached.values())
        numbers = (report.kills, at, missed, report.acknowledged, report.lost, len(report.refused))
        table.add_row(report.what, *map(str, numbers), f"{report.seconds:.0f}")
    print_findings(reports, [report.violated for report in reports], table, as_json=as_json)
