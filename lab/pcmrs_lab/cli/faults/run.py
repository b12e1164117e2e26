"""`pcmrs faults run`: the campaign."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.cli.tables import print_report, styled
from pcmrs_lab.cli.faults.options import PartOf, choosing, chosen, output_option
from pcmrs_lab.cli.workers_options import workers_options

if TYPE_CHECKING:
    from rich.console import RenderableType

    from pcmrs_lab.campaign.report import CampaignReport
    from pcmrs_lab.scale.tasks import Workers

COLOURS = {"passed": "green", "failed": "bold red", "not_proved": "bold red", "not_run": "dim"}


@click.command("run")
@choosing
@click.option(
    "--seed",
    "seeds",
    type=click.IntRange(min=0),
    multiple=True,
    default=(1,),
    show_default=True,
    help="Seed of everything random; may be repeated: every fault is injected with each.",
)
@workers_options(1)
@click.option("--sham", "is_sham", is_flag=True, help="Inject no fault: every row must detect that, or it fails.")
@click.option(
    "--part",
    type=PartOf(),
    default="1/1",
    show_default=True,
    help="Of the selected faults every n-th from the k-th on.",
)
@output_option("Also write faults.json and faults.html")
@json_option
@readable_errors
def run_(
    classes: tuple[str, ...],
    ids: tuple[str, ...],
    seeds: tuple[int, ...],
    workers: Workers,
    is_sham: bool,
    part: tuple[int, int],
    folder: Path | None,
    as_json: bool,
) -> None:
    """Inject faults into separate simulated cells, and check that each response is the required one.

    A fault that cannot be injected on this machine is reported as not run, with the reason. Exit status 1: a required
    response did not come, or an injection was not proved.

    Example: pcmrs faults run --class sensor --seed 1 --seed 2 -o report
    """
    from pcmrs_lab.campaign.report import write_report
    from pcmrs_lab.campaign.run import run_campaign

    (number, parts), distinct = part, list(dict.fromkeys(seeds))
    rows = chosen(classes, ids)[number - 1 :: parts]
    with progress_bar() as progress:
        report = run_campaign(rows, distinct, workers, progress, is_sham=is_sham)
    if folder is not None:
        write_report(report, folder)
    print_report(report, _tables(report), as_json=as_json)
    if report.failed:
        sys.exit(EXIT_REJECTED)


def _tables(report: CampaignReport) -> RenderableType:
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.table import Table

    from pcmrs_lab.campaign.report import OUTCOMES

    kind = "Sham campaign (no fault is injected)" if report.sham else "Fault campaign"
    title = f"{kind}, simulated cells, {len(report.seeds)} seeds, {report.seconds:.0f} s"
    faults = Table("", "fault", "seed", "outcome", "s", "observed response", "reference", box=SIMPLE_HEAD, title=title)
    for result in report.faults:
        outcome = styled(result.outcome.replace("_", " "), style=COLOURS[result.outcome])
        faults.add_row(
            result.id,
            result.title,
            str(result.seed),
            outcome,
            f"{result.seconds:.1f}",
            result.response,
            result.reference,
        )
    counts = Table("class", *(outcome.replace("_", " ") for outcome in OUTCOMES), box=SIMPLE_HEAD)
    for fault_class, found in report.summary.items():
        counts.add_row(fault_class, *(str(found[outcome]) for outcome in OUTCOMES))
    return Group(faults, counts)
