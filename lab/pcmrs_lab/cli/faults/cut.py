"""`pcmrs faults cut`: journals with cut or changed files, or after a power loss."""

from __future__ import annotations

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors
from pcmrs_lab.cli.faults.options import minutes_option, print_findings, seed_option


@click.command()
@click.option("--cuts", type=click.IntRange(min=0), help="Number of random cuts; by default every byte of the tails.")
@click.option("--flips", type=click.IntRange(min=0), help="Number of random bits; by default one of every byte there.")
@click.option("--power", type=click.IntRange(min=0), default=200, show_default=True, help="Power cuts of a writer.")
@seed_option
@minutes_option
@json_option
@readable_errors
def cut(cuts: int | None, flips: int | None, power: int, seed: int, minutes: float | None, as_json: bool) -> None:
    """Damage copies of a journal and open them: a loss must be reported, never silent; power cuts must lose nothing.

    --minutes limits each of the two parts. Exit status 1: a loss was silent, or an acknowledged row was lost.

    Example: pcmrs faults cut --power 1000
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from pcmrs.clock import SystemClock
    from pcmrs_lab.campaign.cuts import cut_and_flip, cut_power

    reports = []
    with progress_bar() as progress:
        reports.append(cut_and_flip(cuts, flips, seed, SystemClock(), minutes=minutes, progress=progress))
        if power:
            reports.append(cut_power(power, seed, SystemClock(), minutes=minutes, progress=progress))
    table = Table("journals", "tried", "reported", "unaffected", "lost", "silent", "broken", "s", box=SIMPLE_HEAD)
    for report in reports:
        numbers = (
            report.tried,
            report.reported,
            report.unaffected,
            report.lost,
            len(report.silent),
            len(report.broken),
        )
        table.add_row(report.what, *map(str, numbers), f"{report.seconds:.0f}")
        for text in (*report.silent[:10], *report.broken[:10]):
            table.add_row(text)
    print_findings(reports, [report.violated for report in reports], table, as_json=as_json)
