"""Options that all experiments share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.options import OutputFile
from pcmrs.cli.printing import say
from pcmrs.cli.values import POSITIVE

if TYPE_CHECKING:
    # For annotations only: --help must not load the experiments.
    from pcmrs_lab.experiment.data_sheets import TrackerName
    from pcmrs_lab.experiment.setup import Drivers, ExperimentSetup, ShowProgress

DEFAULT_RATE = 5.0
REAL_TIME = 1.0
"""Only rate at which drivers of real devices work."""


@dataclass(frozen=True, slots=True)
class ExperimentOptions:
    """Options that all experiments share; `experiment_options` explains them."""

    workflow: str | None
    seed: int
    rate: float
    drivers: Drivers
    noise: TrackerName | None
    plan_file: Path | None
    overrides: tuple[str, ...]
    table: Path | None
    report_file: Path | None

    def setup(self, workflow: str, progress: ShowProgress) -> ExperimentSetup:
        """Return the experiment's setup for a workflow.

        Args:
            workflow: Name of the workflow.
            progress: Called at every step.

        Raises:
            ConfigurationError: The plan cannot be read, or the workflow is not among the published ones.
        """
        from pcmrs.testing.plan import example_plan, read_plan
        from pcmrs_lab.experiment.published import published
        from pcmrs_lab.experiment.setup import ExperimentSetup

        if self.plan_file is None:
            published(workflow)  # refuse an unknown workflow by its name before its plan is missing
        plan = read_plan(self.plan_file or example_plan(workflow))
        overrides = (*self._data_sheet(), *self.overrides)
        return ExperimentSetup(plan, workflow, self.seed, self.rate, self.drivers, overrides, progress)

    def _data_sheet(self) -> list[str]:
        from pcmrs_lab.experiment.data_sheets import data_sheet_settings

        return [] if self.noise is None else data_sheet_settings(self.noise, virtual=self.drivers == "virtual")


def experiment_options(
    workflow: str | None, rate: float = DEFAULT_RATE
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add the options that all experiments share; the command gets them as `options`.

    Args:
        workflow: Default workflow; None for all that were published.
        rate: Default speed.
    """

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def command(**given: Any) -> Any:
            shared = {field.name: given.pop(field.name) for field in fields(ExperimentOptions)}
            shared["rate"] = _rate(shared["rate"], shared["drivers"], rate)
            return function(options=ExperimentOptions(**shared), **given)

        for option in _options(workflow, rate):
            command = option(command)
        return command

    return add


def _rate(given: float | None, drivers: Drivers, default: float) -> float:
    if drivers == "builtin":
        return _reachable(default if given is None else given)
    if given not in (None, REAL_TIME):
        raise click.UsageError(f"--drivers virtual runs in real time: leave out --rate {given:g}.")
    return REAL_TIME


def _reachable(rate: float) -> float:
    """Return the rate that the machine can reach, and print a note if it is less than requested."""
    if rate <= REAL_TIME:
        return rate
    from pcmrs_lab.experiment.speed import processor_share, reachable_speed

    speed = reachable_speed(rate, processor_share())
    if speed.why:
        say(speed.why, err=True)
    return speed.rate


def _options(workflow: str | None, rate: float) -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--set",
            "overrides",
            multiple=True,
            metavar="KEY=VALUE",
            help="Set one value of the daemon's configuration.",
        ),
        click.option("--table", type=OutputFile(), help="Also save the table as this SVG file."),
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
            "--noise",
            type=click.Choice(["vicra", "vega", "spectra"]),
            help="Give tracker and arm the noise, latency and repeatability of data sheets: NDI Polaris, iiwa 14.",
        ),
        click.option(
            "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulated errors."
        ),
        click.option("--workflow", default=workflow, show_default=workflow or "all", help="ratms or femoroplasty."),
    )
