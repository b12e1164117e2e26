"""`pcmrs experiment` and `pcmrs demo`: the paper's experiments on the simulated cell."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pcmrs.cli.options import json_option, plot_option
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the experiments.
    from pcmrs.experiment.placements import PlacementReport
    from pcmrs.experiment.setup import Setup, ShowProgress

DEFAULT_RATE = 5.0
NARROWEST = 112


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options that all experiments share; see `experiment_options` for what they mean."""

    workflow: str | None
    seed: int
    rate: float
    plan_file: Path | None
    overrides: tuple[str, ...]
    picture: Path | None
    report_file: Path | None

    def setup(self, workflow: str, progress: ShowProgress) -> Setup:
        """The experiment's setup for a workflow. Raises `ConfigurationError` when its plan cannot be read."""
        from pcmrs.experiment.plan import example_plan, read_plan
        from pcmrs.experiment.setup import Setup

        plan = read_plan(self.plan_file or example_plan(workflow))
        return Setup(plan, workflow, self.seed, self.rate, self.overrides, progress)


def experiment_options(workflow: str | None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Adds the options that all experiments share; the command gets them as `wanted`.

    Args:
        workflow: The workflow where none is named; None for all that were published.
    """

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def command(**given: Any) -> Any:
            shared = {field.name: given.pop(field.name) for field in fields(Wanted)}
            return function(wanted=Wanted(**shared), **given)

        for option in _options(workflow):
            command = option(command)
        return command

    return add


def _options(workflow: str | None) -> tuple[Callable[..., Any], ...]:
    return (
        click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Sets one value of the daemon."),
        click.option("--picture", type=click.Path(path_type=Path), help="Also save the table as this SVG file."),
        click.option(
            "--report",
            "report_file",
            type=click.Path(path_type=Path),
            metavar="FILE.json",
            help="Also save the report as this JSON file.",
        ),
        click.option(
            "--plan",
            "plan_file",
            type=click.Path(path_type=Path),
            help="Landmarks and poses; by default the workflow's example, examples/WORKFLOW_plan.json.",
        ),
        click.option(
            "--rate", default=DEFAULT_RATE, show_default=True, help="Speed of the simulation against real time."
        ),
        click.option("--seed", default=1, show_default=True, help="Of the simulated errors."),
        click.option("--workflow", default=workflow, show_default=workflow or "all", help="ratms or femoroplasty."),
    )


@click.group()
def experiment() -> None:
    """Repeat the paper's experiments on the simulated cell."""


@experiment.command()
@experiment_options("ratms")
@click.option("--trials", default=12, show_default=True, help="How many placements.")
@click.option(
    "--seeds", default=1, show_default=True, type=click.IntRange(min=1), help="How many seeds, from --seed on."
)
@plot_option
@json_option
@readable_errors
def placements(wanted: Wanted, trials: int, seeds: int, plot: Path | None, as_json: bool) -> None:
    """Place the tool at planned poses and measure it, beside the paper's errors.

    Example: pcmrs experiment placements --seeds 10 --report placements.json --plot placements.png

    With several seeds each has a daemon of its own, one after the other; exit status 1 when a command of one was
    refused, such as a registration.
    """
    if seeds == 1:
        _plot([_placements(wanted, trials, as_json=as_json)], plot)
    else:
        _placements_over(wanted, trials, seeds, plot, as_json=as_json)


@experiment.command()
@experiment_options(None)
@click.option(
    "--runs",
    type=click.IntRange(min=1),
    help="Instead, judge simulated touches of every row so many times, without a daemon.",
)
@plot_option
@json_option
@readable_errors
def failures(wanted: Wanted, runs: int | None, plot: Path | None, as_json: bool) -> None:
    """Inject the paper's operator errors; each must be rejected where the paper says.

    Exit status 1 when a run did not end as published. With --runs, false accept and false reject rates of each gate and
    of a fixed residual limit alone; the exit status is 0 whatever they are.

    Example: pcmrs experiment failures --runs 1000 --seed 1 --report rates.json --plot rates.png
    """
    from pcmrs.experiment.published import PUBLISHED

    if wanted.plan_file is not None and wanted.workflow is None:
        raise click.UsageError("--plan is the plan of one workflow: name it with --workflow.")
    if plot is not None and runs is None:
        raise click.UsageError("--plot draws the rates of many runs: say how many with --runs.")
    workflows = list(PUBLISHED) if wanted.workflow is None else [wanted.workflow]
    if runs is None:
        _failures(wanted, workflows, as_json=as_json)
    else:
        _failure_rates(wanted, workflows, runs, plot, as_json=as_json)


def _failures(wanted: Wanted, workflows: list[str], *, as_json: bool) -> None:
    from pcmrs.cli.tables import failure_table
    from pcmrs.experiment.failures import run_failures

    with _progress() as progress:
        report = run(run_failures([wanted.setup(workflow, progress) for workflow in workflows]))
    _show(report, failure_table(report), wanted, as_json=as_json)
    if report.summary.as_published < report.summary.runs:
        raise SystemExit(EXIT_REJECTED)


def _failure_rates(wanted: Wanted, workflows: list[str], runs: int, plot: Path | None, *, as_json: bool) -> None:
    from pcmrs.analysis.plots import save_png
    from pcmrs.cli.monte_carlo_tables import monte_carlo_tables
    from pcmrs.experiment.monte_carlo import run_monte_carlo
    from pcmrs.experiment.monte_carlo_plot import monte_carlo_figure

    with _progress() as progress:
        report = run_monte_carlo([wanted.setup(workflow, progress) for workflow in workflows], runs)
    _show(report, monte_carlo_tables(report), wanted, as_json=as_json)
    if plot is not None:
        save_png(monte_carlo_figure(report), plot)


@click.command()
@experiment_options("ratms")
@readable_errors
def demo(wanted: Wanted) -> None:
    """Run a whole procedure on the simulated cell: plan, digitize, register, and 12 placements.

    With --workflow femoroplasty the bone is drilled and injected at the last of them.
    """
    click.echo(
        f"A simulated cell, {wanted.rate:g} times as fast as real time; speed limits as configured. "
        "Commands go over UDP, as from 3D Slicer.\nResearch software, not a medical device."
    )
    _placements(wanted, 12, as_json=False)


def _placements(wanted: Wanted, trials: int, *, as_json: bool) -> PlacementReport:
    from pcmrs.cli.tables import placement_table
    from pcmrs.experiment.placements import run_placements

    with _progress() as progress:
        report = run(run_placements(wanted.setup(wanted.workflow or "ratms", progress), trials))
    _show(report, placement_table(report), wanted, as_json=as_json)
    return report


def _placements_over(wanted: Wanted, trials: int, seeds: int, plot: Path | None, *, as_json: bool) -> None:
    from pcmrs.cli.seed_tables import seeds_tables
    from pcmrs.experiment.placement_seeds import run_seeds

    with _progress() as progress:
        report = run(run_seeds(wanted.setup(wanted.workflow or "ratms", progress), trials, seeds))
    _show(report, seeds_tables(report), wanted, as_json=as_json)
    _plot(report.reports, plot)
    if len(report.reports) < seeds:
        raise SystemExit(EXIT_REJECTED)


def _plot(reports: list[PlacementReport], plot: Path | None) -> None:
    from pcmrs.analysis.plots import save_png
    from pcmrs.experiment.placement_plot import placements_figure

    if plot is not None and reports:
        save_png(placements_figure(reports), plot)


def _show(report: msgspec.Struct, table: RenderableType, wanted: Wanted, *, as_json: bool) -> None:
    encoded = msgspec.json.encode(report)
    if as_json:
        click.echo(encoded.decode())
    else:
        _print(table, wanted.picture)
    if wanted.report_file is not None:
        wanted.report_file.write_bytes(encoded + b"\n")


def _print(table: RenderableType, picture: Path | None) -> None:
    """Prints a table; in a narrow terminal its lines wrap, so that no number is cut.

    Args:
        table: What to print.
        picture: SVG file that shows the same, if wanted.
    """
    console = Console(width=max(Console().width, NARROWEST), record=picture is not None)
    console.print(table)
    if picture is not None:
        svg = console.export_svg(title="pcmrs")
        # Rich refers to a web font; a picture of a medical device's results loads nothing from anywhere.
        picture.write_text(re.sub(r"@font-face\s*{[^}]*}", "", svg))


@contextmanager
def _progress() -> Iterator[ShowProgress]:
    """A bar on standard error, so that standard output holds the result only."""
    columns = (TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=None)

        def show(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        yield show
