"""Placement experiment over several seeds of the simulated errors, since one registration says little about others."""

from __future__ import annotations

import msgspec

from pcmrs.cli.running import run
from pcmrs.errors import CommandRefusedError
from pcmrs.testing.plan import Plan
from pcmrs_lab.experiment.placements import PlacementReport, PlacementSummary, run_placements, summary_of
from pcmrs_lab.experiment.setup import Drivers, ExperimentSetup
from pcmrs_lab.scale.tasks import HERE, Workers, run_tasks


class SeedRun(msgspec.Struct, frozen=True):
    """Result of one seed: its report, or the reason why a command was refused, such as a registration."""

    seed: int
    report: PlacementReport | None
    refused: str | None


class SeedsReport(msgspec.Struct, frozen=True):
    """Results of the experiment over several seeds.

    Attributes:
        pooled: All placements of all completed seeds; None if none was completed.
    """

    experiment: str
    workflow: str
    rate: float
    settings: list[str]
    simulated: bool
    runs: list[SeedRun]
    pooled: PlacementSummary | None

    @property
    def reports(self) -> list[PlacementReport]:
        """Reports of the completed seeds."""
        return [run.report for run in self.runs if run.report is not None]


class PlacementTask(msgspec.Struct, frozen=True):
    """Experiment with one seed.

    Attributes:
        plan: Landmarks and poses.
        workflow: Name of the workflow.
        seed: Seed of the simulated errors.
        rate: Seconds of the simulated cell per second of the machine.
        drivers: Devices of the daemon.
        overrides: Further settings of the daemon.
        trials: Number of placements.
    """

    plan: Plan
    workflow: str
    seed: int
    rate: float
    drivers: Drivers
    overrides: list[str]
    trials: int


def run_seeds(setup: ExperimentSetup, trials: int, seeds: int, workers: Workers = HERE) -> SeedsReport:
    """Repeat the experiment, each time on its own daemon.

    Args:
        setup: Setup; its seed is the first.
        trials: Number of placements with each seed.
        seeds: Number of seeds.
        workers: Where the daemons run, one at a time on each.

    Returns:
        Results of all seeds.

    Raises:
        ConfigurationError: As for `run_placements`, or the workers cannot be used.
        DeviceError: A daemon did not start.
    """
    common = (setup.rate, setup.drivers, list(setup.overrides), trials)
    tasks = [PlacementTask(setup.plan, setup.workflow, setup.seed + index, *common) for index in range(seeds)]
    found: dict[int, SeedRun] = {}
    for task, run_of_seed in run_tasks(place_with_seeds, tasks, workers, 1):
        found[task.seed] = run_of_seed
        setup.progress(f"seed {task.seed}", len(found), seeds)
    runs = [found[task.seed] for task in tasks]
    reports = [each.report for each in runs if each.report is not None]
    done = [trial for report in reports for trial in report.trials]
    failed = sum(len(report.failed) for report in reports)
    return SeedsReport(
        experiment="placements",
        workflow=setup.workflow,
        rate=setup.rate,
        settings=setup.settings(),
        simulated=True,
        runs=runs,
        pooled=summary_of(setup.workflow, done, failed) if done else None,
    )


def place_with_seeds(tasks: list[PlacementTask]) -> list[SeedRun]:
    """Run the experiment with each seed, one after the other.

    Args:
        tasks: Experiments.
    """
    return [run(_place_with_seed(task)) for task in tasks]


async def _place_with_seed(task: PlacementTask) -> SeedRun:
    common = (task.rate, task.drivers, task.overrides, lambda _text, _done, _total: None)
    try:
        setup = ExperimentSetup(task.plan, task.workflow, task.seed, *common)
        return SeedRun(task.seed, await run_placements(setup, task.trials), None)
    except CommandRefusedError as error:
        return SeedRun(task.seed, None, error.text)
