"""Placement experiment over several seeds of the simulated errors, since one registration says little about others."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from pcmrs.errors import CommandRefusedError
from pcmrs_lab.experiment.placements import PlacementReport, PlacementSummary, run_placements, summary_of
from pcmrs_lab.experiment.setup import ExperimentSetup


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


async def run_seeds(setup: ExperimentSetup, trials: int, seeds: int) -> SeedsReport:
    """Repeat the experiment, each time on its own daemon, one after the other.

    Args:
        setup: Setup; its seed is the first.
        trials: Number of placements with each seed.
        seeds: Number of seeds.

    Returns:
        Results of all seeds.

    Raises:
        ConfigurationError: As for `run_placements`.
        DeviceError: A daemon did not start.
    """
    runs = [await _run(setup, trials, index, seeds) for index in range(seeds)]
    done = [trial for run in runs if run.report is not None for trial in run.report.trials]
    return SeedsReport(
        experiment="placements",
        workflow=setup.workflow,
        rate=setup.rate,
        settings=setup.settings(),
        simulated=True,
        runs=runs,
        pooled=summary_of(setup.workflow, done) if done else None,
    )


async def _run(setup: ExperimentSetup, trials: int, index: int, seeds: int) -> SeedRun:
    seed = setup.seed + index

    def progress(text: str, done: int, total: int) -> None:
        setup.progress(f"seed {seed}: {text}", index * total + done, seeds * total)

    try:
        return SeedRun(seed, await run_placements(replace(setup, seed=seed, progress=progress), trials), None)
    except CommandRefusedError as error:
        return SeedRun(seed, None, error.text)
