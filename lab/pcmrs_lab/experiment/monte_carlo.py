"""Monte Carlo of the published failure injections: how often the verdict errs, by gate.

There is no daemon and no robot: touches are the planned landmarks, a planning error, the noise of the touch and the
injected offset, seen from a body in a random pose; `judge` decides. The tracker's error, a twentieth of that, is left
out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from pcmrs.analysis.placements import Summary, summarize
from pcmrs.errors import ConfigurationError
from pcmrs.installed import entry_points_of
from pcmrs.registration import RegistrationLimits, RegistrationVerdict, judge
from pcmrs.settings import DRIVER_SETTINGS, Settings, read_settings
from pcmrs.spatial import Floats, Transform
from pcmrs.testing.plan import Plan
from pcmrs_lab.experiment.published import FailureRun, published
from pcmrs_lab.experiment.setup import ExperimentSetup
from pcmrs_lab.scale.tasks import HERE, Workers, run_tasks

ALL_GATES = "verdict"
FIXED_LIMIT = "fixed_limit"
GATES = ("wrong_unit", "mirrored", "swapped_landmarks", "landmark_outlier", "residual_too_large", "tre_too_large")
OFFSET = "large_digitization_error"
RUNS_AT_ONCE = 1000
"""Number of runs of a row that one generator draws, so that many runs of a row need not run one after the other.

It is fixed, and not a share of the workers, because it decides the results.
"""


class TouchesTask(msgspec.Struct, frozen=True):
    """Runs of one row to simulate and judge.

    Attributes:
        row: Row of the published table.
        seed: Seed of the experiment.
        block: Number of the block of runs of this row.
        runs: Number of runs.
    """

    row: FailureRun
    plan: Plan
    noise: NoiseUsed
    seed: int
    block: int
    runs: int


class JudgedTouches(msgspec.Struct, frozen=True):
    """Verdicts on the runs of one task.

    Attributes:
        refused: Number of runs that any gate refuses.
        refused_by: Number of runs that each gate refuses, and that a fixed residual limit alone would refuse.
        named: Number of runs in which the displaced landmark is the suspect.
        residuals_mm: Residuals of the runs with a registration, mm.
    """

    refused: int
    refused_by: dict[str, int]
    named: int
    residuals_mm: list[float]


class RowRates(msgspec.Struct, frozen=True):
    """Results of many runs of one row of the published table.

    Attributes:
        by_construction: True if the workflow cannot continue without the landmark under any noise: nothing was
            simulated.
        refused: Number of runs that any gate refuses.
        refused_by: Number of runs that each gate refuses, and that a fixed residual limit alone would refuse.
        named: Number of runs in which the displaced landmark is the suspect.
        residual_mm: Mean distance of the landmarks over the runs, mm.
    """

    run: int
    workflow: str
    injection: str
    landmark: int | None
    by_construction: bool
    runs: int
    refused: int
    refused_by: dict[str, int]
    named: int | None
    residual_mm: Summary | None
    published_residual_mm: float | None


class GateRates(msgspec.Struct, frozen=True):
    """Wrong decisions of one gate, or of all; rows that are refused by construction are not counted.

    Attributes:
        gate: Code of the gate, ``verdict`` for all together, or ``fixed_limit`` for a residual limit alone.
        false_rejects: Share of the controls that it refuses.
        false_accepts: Share of the runs with a displaced landmark that it does not refuse. A gate that is skipped,
            because a wrong unit, side or order was found before, refuses nothing; ``fixed_limit`` is never skipped.
    """

    workflow: str
    gate: str
    false_rejects: float
    false_accepts: float


class NoiseUsed(msgspec.Struct, frozen=True):
    """Simulated errors and limits of one workflow.

    Attributes:
        planning_bias_mm: Simulated bias of the plan, standard deviation per axis, mm.
        sigma_mm: Standard deviation that the verdict expects of both together, mm.
        noise_mm: Simulated noise of a touch, standard deviation per axis, mm.
    """

    planning_bias_mm: float
    noise_mm: float
    sigma_mm: float
    residual_limit_mm: float
    tre_limit_mm: float
    false_alarm: float


class MonteCarloReport(msgspec.Struct, frozen=True):
    """All rows and rates."""

    experiment: str
    seed: int
    runs: int
    simulated: bool
    settings: list[str]
    noise: dict[str, NoiseUsed]
    rows: list[RowRates]
    rates: list[GateRates]


def run_monte_carlo(setups: Sequence[ExperimentSetup], runs: int, workers: Workers = HERE) -> MonteCarloReport:
    """Judge every published row `runs` times with simulated touches; equal seeds give equal results.

    Args:
        setups: One setup for each workflow, otherwise equal; at least one.
        runs: Number of runs of each row.
        workers: Where the rows are judged.

    Returns:
        Rows and rates.

    Raises:
        ConfigurationError: A workflow is not among the published ones, or the settings or workers cannot be used.
    """
    noise = {setup.workflow: _noise(setup) for setup in setups}
    table = [(setup, row) for setup in setups for row in published(setup.workflow).failures]
    tasks = [
        TouchesTask(row, setup.plan, noise[setup.workflow], setup.seed, block, min(RUNS_AT_ONCE, runs - first))
        for setup, row in table
        if not _by_construction(row)
        for block, first in enumerate(range(0, runs, RUNS_AT_ONCE))
    ]
    judged: dict[int, dict[int, JudgedTouches]] = {row.run: {} for _, row in table}
    done, total = 0, sum(task.runs for task in tasks)
    for task, found in run_tasks(judge_touches, tasks, workers, 1):
        judged[task.row.run][task.block] = found
        done += task.runs
        setups[0].progress(f"run {task.row.run}: {task.row.injection.replace('_', ' ')}", done, total)
    setups[0].progress("done", total, total)
    rows = [_row(setup.workflow, row, runs, judged[row.run]) for setup, row in table]
    rows.sort(key=lambda row: row.run)
    return MonteCarloReport(
        experiment="failures_monte_carlo",
        seed=setups[0].seed,
        runs=runs,
        simulated=True,
        settings=list(setups[0].overrides),
        noise=noise,
        rows=rows,
        rates=[rates for setup in setups for rates in _rates(setup.workflow, rows)],
    )


def judge_touches(tasks: list[TouchesTask]) -> list[JudgedTouches]:
    """Simulate and judge the runs of each task.

    Args:
        tasks: Runs.
    """
    return [_judge_all(task) for task in tasks]


def _noise(setup: ExperimentSetup) -> NoiseUsed:
    """Return errors and limits as this workflow and its simulated cell are configured."""
    settings = read_settings(overrides=[f"workflow={setup.workflow}", *setup.overrides])
    limits = settings.procedure.registration
    bias_mm, touch_mm = _touch_errors_mm(settings)
    return NoiseUsed(
        planning_bias_mm=bias_mm,
        noise_mm=touch_mm,
        sigma_mm=limits.sigma_mm,
        residual_limit_mm=limits.residual_limit_mm,
        tre_limit_mm=limits.tre_limit_mm,
        false_alarm=limits.false_alarm,
    )


def _touch_errors_mm(settings: Settings) -> tuple[float, float]:
    """Return planning bias and noise of a touch of the simulated pointer, mm per axis."""
    for point in (each for each in entry_points_of(DRIVER_SETTINGS) if each.name == "sim"):
        errors = msgspec.convert(settings.sim, point.load()).digitization
        return errors.planning_bias_mm, errors.noise_mm
    raise ConfigurationError(
        "The simulated cell, from which this experiment takes its errors, is not installed: install pcmrs-sim."
    )


def _by_construction(row: FailureRun) -> bool:
    return row.injection not in (OFFSET, "none")


def _row(workflow: str, run: FailureRun, runs: int, blocks: Mapping[int, JudgedTouches]) -> RowRates:
    by_construction = _by_construction(run)
    judged = [blocks[number] for number in sorted(blocks)]
    residuals_mm = [residual for each in judged for residual in each.residuals_mm]
    names = () if by_construction else (*GATES, FIXED_LIMIT)
    return RowRates(
        run=run.run,
        workflow=workflow,
        injection=run.injection,
        landmark=run.landmark,
        by_construction=by_construction,
        runs=runs,
        refused=runs if by_construction else sum(each.refused for each in judged),
        refused_by={name: sum(each.refused_by[name] for each in judged) for name in names},
        named=sum(each.named for each in judged) if run.injection == OFFSET else None,
        residual_mm=summarize(residuals_mm) if residuals_mm else None,
        published_residual_mm=run.residual_mm,
    )


def _judge_all(task: TouchesTask) -> JudgedTouches:
    verdicts = list(_verdicts(task))
    refused_by = Counter(gate.name for verdict in verdicts for gate in verdict.gates if not gate.accepted)
    refused_by[FIXED_LIMIT] = sum(_exceeds_fixed_limit(verdict, task.noise) for verdict in verdicts)
    return JudgedTouches(
        refused=sum(not verdict.accepted for verdict in verdicts),
        refused_by={name: refused_by[name] for name in (*GATES, FIXED_LIMIT)},
        named=sum(verdict.suspect == (task.row.landmark or 0) - 1 for verdict in verdicts),
        residuals_mm=[each.registration.residual * 1e3 for each in verdicts if each.registration is not None],
    )


def _verdicts(task: TouchesTask) -> Iterator[RegistrationVerdict]:
    rng, noise = np.random.default_rng((task.seed, task.row.run, task.block)), task.noise
    limits = RegistrationLimits(
        residual=noise.residual_limit_mm / 1e3,
        sigma=noise.sigma_mm / 1e3,
        tre=noise.tre_limit_mm / 1e3,
        false_alarm=noise.false_alarm,
    )
    planned = np.array([landmark.position for landmark in task.plan.landmarks])
    names = [landmark.name for landmark in task.plan.landmarks]
    for _ in range(task.runs):
        digitized = _touched(rng, task.plan, task.row, noise)
        yield judge(planned, digitized, limits, names=names, target=task.plan.poses[0].position)


def _touched(rng: np.random.Generator, plan: Plan, run: FailureRun, noise: NoiseUsed) -> Floats:
    """Return the landmarks as a simulated person digitizes them, in body_ref, m, (N, 3)."""
    points = np.array([landmark.position for landmark in plan.landmarks])
    points += rng.normal(0.0, noise.planning_bias_mm / 1e3, points.shape)
    points += rng.normal(0.0, noise.noise_mm / 1e3, points.shape)
    if run.landmark is not None and run.offset_in_image is not None:
        points[run.landmark - 1] += run.offset_in_image
    body_ref_from_image = Transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.3, 0.3, 3))
    return body_ref_from_image @ points


def _exceeds_fixed_limit(verdict: RegistrationVerdict, noise: NoiseUsed) -> bool:
    """Return whether a fixed residual limit alone would refuse, or there is no registration at all."""
    return verdict.registration is None or verdict.registration.residual * 1e3 > noise.residual_limit_mm


def _rates(workflow: str, rows: Sequence[RowRates]) -> Iterator[GateRates]:
    own = [row for row in rows if row.workflow == workflow and not row.by_construction]
    controls = [row for row in own if row.injection == "none"]
    displaced = [row for row in own if row.injection == OFFSET]
    yield GateRates(
        workflow,
        ALL_GATES,
        sum(row.refused for row in controls) / sum(row.runs for row in controls),
        1.0 - sum(row.refused for row in displaced) / sum(row.runs for row in displaced),
    )
    for gate in (FIXED_LIMIT, *GATES):
        yield GateRates(
            workflow,
            gate,
            sum(row.refused_by[gate] for row in controls) / sum(row.runs for row in controls),
            1.0 - sum(row.refused_by[gate] for row in displaced) / sum(row.runs for row in displaced),
        )
