"""Options that all experiments share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.options import OutputFile
from pcmrs.cli.values import POSITIVE

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the experiments.
    from pcmrs_lab.experiment.setup import Drivers, ExperimentSetup, ShowProgress

DEFAULT_RATE = 5.0
REAL_TIME = 1.0
"""Drivers of real devices know no other."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options that all experiments share; see `experiment_options` for what they mean."""

    workflow: str | None
    seed: int
    rate: float
    drivers: Drivers
    plan_file: Path | None
    overrides: tuple[str, ...]
    picture: Path | None
    report_file: Path | None

    def setup(self, workflow: str, progress: ShowProgress) -> ExperimentSetup:
        """The experiment's setup for a workflow. Raises `ConfigurationError` when its plan cannot be read."""
        from pcmrs.testing.plan import example_plan, read_plan
        from pcmrs_lab.experiment.published import published
        from pcmrs_lab.experiment.setup import ExperimentSetup

        if self.plan_file is None:
            published(workflow)  # an unknown workflow is refused by name, not for its missing plan
        plan = read_plan(self.plan_file or example_plan(workflow))
        return ExperimentSetup(plan, workflow, self.seed, self.rate, self.drivers, self.overrides, progress)


def experiment_options(
    workflow: str | None, rate: float = DEFAULT_RATE
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Adds the options that all experiments share; the command gets them as `wanted`.

    Args:
        workflow: The workflow where none is named; None for all that were published.
        rate: The speed where none is given.
    """

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def command(**given: Any) -> Any:
            shared = {field.name: given.pop(field.name) for field in fields(Wanted)}
            shared["rate"] = _rate(shared["rate"], shared["drivers"], rate)
            return function(wanted=Wanted(**shared), **given)

        for option in _options(workflow, rate):
            command = option(command)
        return command

    return add


def _rate(given: float | None, drivers: Drivers, default: float) -> float:
    if drivers == "builtin":
        return _kept(default if given is None else given)
    if given not in (None, REAL_TIME):
        raise click.UsageError(f"--drivers virtual runs in real time: leave out --rate {given:g}.")
    return REAL_TIME


def _kept(rate: float) -> float:
    """The rate that the machine can do; says so where that is less."""
    if rate <= REAL_TIME:
        return rate
    from pcmrs_lab.experiment.speed import kept_speed, processor_share

    speed = kept_speed(rate, processor_share())
    if speed.why:
        click.echo(speed.why, err=True)
    return speed.rate


def _options(workflow: str | None, rate: float) -> tuple[Callable[..., Any], ...]:
    return (
        click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Sets one value of the daemon."),
        click.option("--picture", type=OutputFile(), help="Also save the table as this SVG file."),
        click.option(
            "--report",
            "report_file",
            type=OutputFile(),
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
            "--rate",
            type=POSITIVE,
            show_default=f"{rate:g}; 1 with virtual drivers",
            help="Speed of the simulation against real time.",
        ),
        click.option(
            "--drivers",
            type=click.Choice(["builtin", "virtual"]),
            default="builtin",
            show_default=True,
            help="virtual: the drivers kst and ndi, over TCP, with a virtual cabinet and tracker.",
        ),
        click.option(
            "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the simulated errors."
        ),
        click.option("--workflow", default=workflow, show_default=workflow or "all", help="ratms or femoroplasty."),
    )
