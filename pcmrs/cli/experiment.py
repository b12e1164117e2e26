"""`pcmrs experiment` and `pcmrs demo`: the paper's experiments on the simulated cell."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pcmrs.cli.options import json_option
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run

DEFAULT_RATE = 5.0
NARROWEST = 100


def experiment_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Adds the options that all experiments share."""
    for option in (
        click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Sets one value of the daemon."),
        click.option("--picture", type=click.Path(path_type=Path), help="Also save the table as this SVG file."),
        click.option(
            "--plan",
            "plan_file",
            type=click.Path(path_type=Path),
            help="Landmarks and poses; by default the example's, examples/ratms_plan.json.",
        ),
        click.option(
            "--rate", default=DEFAULT_RATE, show_default=True, help="Speed of the simulation against real time."
        ),
        click.option("--seed", default=1, show_default=True, help="Of the simulated errors."),
        click.option("--workflow", default="ratms", show_default=True, help="Name of the workflow."),
    ):
        function = option(function)
    return function


@click.group()
def experiment() -> None:
    """Repeat the paper's experiments on the simulated cell."""


@experiment.command()
@experiment_options
@click.option("--trials", default=12, show_default=True, help="How many placements.")
@json_option
@readable_errors
def placements(
    workflow: str,
    seed: int,
    rate: float,
    plan_file: Path | None,
    overrides: tuple[str, ...],
    picture: Path | None,
    trials: int,
    as_json: bool,
) -> None:
    """Place the tool at planned poses and measure it, beside the paper's errors."""
    _placements(workflow, seed, rate, plan_file, overrides, picture, trials, as_json=as_json)


@experiment.command()
@experiment_options
@json_option
@readable_errors
def failures(
    workflow: str,
    seed: int,
    rate: float,
    plan_file: Path | None,
    overrides: tuple[str, ...],
    picture: Path | None,
    as_json: bool,
) -> None:
    """Inject the paper's operator errors; each must be rejected where the paper says.

    Exit status 1 when a run did not end as published.
    """
    from pcmrs.cli.tables import failure_table
    from pcmrs.experiment.failures import run_failures
    from pcmrs.experiment.plan import example_plan, read_plan

    with _progress() as progress:
        report = run(
            run_failures(
                read_plan(plan_file or example_plan(workflow)),
                workflow=workflow,
                seed=seed,
                rate=rate,
                overrides=overrides,
                progress=progress,
            )
        )
    if as_json:
        click.echo(msgspec.json.encode(report).decode())
    else:
        _print(failure_table(report), picture)
    if report.summary.as_published < report.summary.runs:
        raise SystemExit(EXIT_REJECTED)


@click.command()
@experiment_options
@readable_errors
def demo(
    workflow: str, seed: int, rate: float, plan_file: Path | None, overrides: tuple[str, ...], picture: Path | None
) -> None:
    """Run a whole procedure on the simulated cell: plan, digitize, register, and 12 placements."""
    click.echo(
        f"A simulated cell, {rate:g} times as fast as real time; speed limits as configured. "
        "All commands go over UDP, as from 3D Slicer.\nResearch software, not a medical device."
    )
    _placements(workflow, seed, rate, plan_file, overrides, picture, 12, as_json=False)


def _placements(
    workflow: str,
    seed: int,
    rate: float,
    plan_file: Path | None,
    overrides: tuple[str, ...],
    picture: Path | None,
    trials: int,
    *,
    as_json: bool,
) -> None:
    from pcmrs.cli.tables import placement_table
    from pcmrs.experiment.placements import run_placements
    from pcmrs.experiment.plan import example_plan, read_plan

    with _progress() as progress:
        report = run(
            run_placements(
                read_plan(plan_file or example_plan(workflow)),
                workflow=workflow,
                seed=seed,
                trials=trials,
                rate=rate,
                overrides=overrides,
                progress=progress,
            )
        )
    if as_json:
        click.echo(msgspec.json.encode(report).decode())
    else:
        _print(placement_table(report), picture)


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
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar on standard error, so that standard output holds the result only."""
    columns = (TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=None)

        def show(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        yield show
