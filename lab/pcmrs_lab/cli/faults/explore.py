"""`pcmrs faults explore`: random procedures under random faults, in simulated time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.cli.tables import print_report, styled
from pcmrs_lab.cli.faults.options import minutes_option, output_option, seed_option
from pcmrs_lab.cli.workers_options import workers_options

if TYPE_CHECKING:
    from rich.console import RenderableType

    from pcmrs_lab.campaign.explore.exploring import Explored
    from pcmrs_lab.campaign.explore.script import Physics
    from pcmrs_lab.campaign.explore.session import ExplorationResult
    from pcmrs_lab.scale.tasks import Workers


@click.command("explore")
@click.option("--sessions", type=click.IntRange(min=1), help="Number of sessions; 500 unless --minutes is given.")
@seed_option
@minutes_option
@workers_options(2)
@click.option("--workflow", default="ratms", show_default=True, help="Name of a workflow.")
@click.option(
    "--physics",
    type=click.Choice(["kinematic", "mujoco"]),
    default="kinematic",
    show_default=True,
    help="Physics of the simulated arm; with mujoco all streams have the rates of a real cell, too.",
)
@click.option(
    "--script",
    "script_file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Run this one session only, as written by -o.",
)
@output_option("Write the shrunk script of each broken session")
@json_option
@readable_errors
def explore(
    sessions: int | None,
    seed: int,
    minutes: float | None,
    workers: Workers,
    workflow: str,
    physics: Physics,
    script_file: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Run random procedures under random faults, and check the invariants after every event.

    The whole cell runs in simulated time: daemon, device node, devices, and the network between them. Each
    session is determined by its seed: --seed for the first, and one more for each further one. A session in which an
    invariant does not hold is shrunk to a short script. Exit status 1: an invariant did not hold.

    Example: pcmrs faults explore --sessions 500 --seed 1 -o broken
    """
    from pcmrs_lab.campaign.explore import exploring
    from pcmrs_lab.campaign.explore.script import read_script, write_script
    from pcmrs_lab.campaign.explore.session import run_session

    if script_file is not None:
        found = run_session(read_script(script_file))
        print_report(found, _summary(found), as_json=as_json)
        sys.exit(EXIT_REJECTED if found.invariant else 0)
    many = sessions if sessions is not None or minutes is not None else 500
    with progress_bar() as progress:
        report = exploring.explore(
            workflow, seed, many, minutes=minutes, workers=workers, physics=physics, progress=progress
        )
    if folder is not None:
        for broken in report.broken:
            write_script(broken.script, folder / f"{workflow}-{broken.seed}-{broken.invariant}.json")
    print_report(report, _tables(report), as_json=as_json)
    if report.broken:
        sys.exit(EXIT_REJECTED)


def _summary(found: ExplorationResult) -> RenderableType:
    from rich.console import Group

    session = f"Session of seed {found.seed}, {found.time:.1f} s simulated, {found.rows} rows, {found.digest}"
    if not found.invariant:
        return Group(session, "held")
    return Group(session, styled(f"{found.invariant} at {found.at:.3f} s: {found.text}", style="bold red"))


def _tables(report: Explored) -> RenderableType:
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.table import Table

    from pcmrs_lab.campaign.explore.exploring import as_lines
    from pcmrs_lab.campaign.explore.faults import FAULTS

    title = f"{report.sessions} simulated sessions of {report.workflow}, {report.physics} arm, seeds from {report.seed}"
    caption = f"{report.simulated:.0f} s simulated in {report.seconds:.0f} s: {report.rate:.0f} times real time."
    faults = Table("fault", "rows", box=SIMPLE_HEAD, title=title, caption=caption)
    faults.add_column("injected", justify="right")
    for name, times in report.faults.items():
        faults.add_row(name, " ".join(FAULTS[name].rows), str(times) if times else styled("never", style="red"))
    violations: list[RenderableType] = []
    for each in report.broken:
        heading = f"seed {each.seed}: {each.invariant} at {each.at:.3f} s: {each.text}"
        acts = f"{len(each.script.acts)} of {each.acts} acts show it:"
        violations += [styled(heading, style="bold red"), styled(acts, *as_lines(each.script))]
    return Group(faults, *(violations or ["All invariants held after every event."]))
