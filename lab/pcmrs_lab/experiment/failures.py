"""Failure injections: an operator omits a step, or digitizes badly, and the workflow must refuse."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import msgspec

from pcmrs.errors import CommandRefusedError
from pcmrs.testing.plan import Plan
from pcmrs_lab.experiment.placements import once_seen
from pcmrs_lab.experiment.private import ExperimentBench, private_bench
from pcmrs_lab.experiment.published import FailureRun, published
from pcmrs_lab.experiment.setup import ExperimentSetup
from pcmrs_lab.experiment.treatment import prepare

NEXT_STATE = {"000": "100", "100": "110", "110": "111"}
"""Next state of the registration, by the state in which it stayed."""


class FailureResult(msgspec.Struct, frozen=True):
    """Result of one run, with the published one.

    Attributes:
        run: Number in the paper's table.
        outcome: ``completed`` or ``rejected``.
        rejected_at: State of the registration that could not be reached.
        residual_mm: Mean distance of the landmarks, if a registration was tried.
        reason: Code of the rejection.
        motion_refused: True if an approach was refused afterwards; None in completed runs.
    """

    run: int
    workflow: str
    injection: str
    landmark: int | None
    outcome: str
    rejected_at: str | None
    residual_mm: float | None
    reason: str | None
    motion_refused: bool | None
    published_rejected_at: str | None
    published_residual_mm: float | None


class FailureSummary(msgspec.Struct, frozen=True):
    """Number of runs that ended as published."""

    runs: int
    as_published: int
    controls_completed: int
    injections_rejected: int


class FailureReport(msgspec.Struct, frozen=True):
    """Results of all runs.

    Attributes:
        residual_limits_mm: Limits in force, by workflow.
        runs: Results in the order of the paper's table.
    """

    experiment: str
    seed: int
    rate: float
    settings: list[str]
    simulated: bool
    residual_limits_mm: dict[str, float]
    runs: list[FailureResult]
    summary: FailureSummary


async def run_failures(setups: Sequence[ExperimentSetup]) -> FailureReport:
    """Run every published failure injection of some workflows over UDP, each workflow on its own daemon.

    Every run has different simulated errors: seed + number of the run.

    Args:
        setups: One setup for each workflow, otherwise equal; at least one.

    Returns:
        Results of all runs.

    Raises:
        ConfigurationError: A workflow is not among the published ones.
        CommandRefusedError: The daemon refused a command that must be accepted.
        DeviceError: The daemon did not start.
    """
    total = sum(len(published(setup.workflow).failures) for setup in setups)
    results: list[FailureResult] = []
    limits: dict[str, float] = {}
    for setup in setups:
        limits[setup.workflow] = await _run_workflow(setup, results, total)
    setups[0].progress("done", total, total)
    return FailureReport(
        experiment="failures",
        seed=setups[0].seed,
        rate=setups[0].rate,
        settings=setups[0].settings(),
        simulated=True,
        residual_limits_mm=limits,
        runs=sorted(results, key=lambda result: result.run),
        summary=FailureSummary(
            runs=len(results),
            as_published=sum(result.rejected_at == result.published_rejected_at for result in results),
            controls_completed=sum(r.outcome == "completed" for r in results if r.injection == "none"),
            injections_rejected=sum(r.outcome == "rejected" for r in results if r.injection != "none"),
        ),
    )


async def _run_workflow(setup: ExperimentSetup, results: list[FailureResult], total: int) -> float:
    """Add the results of one workflow, and return its residual limit, mm."""
    setup.progress("starting the daemon", len(results), total)
    async with private_bench([f"workflow={setup.workflow}", *setup.settings()]) as bench:
        await bench.planner.connect()
        await prepare(bench.client, setup.workflow)
        for run in published(setup.workflow).failures:
            setup.progress(f"run {run.run}: {run.injection.replace('_', ' ')}", len(results), total)
            await bench.scene.reseed(setup.seed + run.run)
            results.append(await _run(bench, setup, run))
            await bench.planner.reinitiate()
        return _limit_mm(bench)


async def _run(bench: ExperimentBench, setup: ExperimentSetup, run: FailureRun) -> FailureResult:
    """Run one procedure up to the registration, with the operator's error in it."""
    plan = setup.plan
    pose, operate = plan.poses[0], OPERATORS[run.injection]
    reason: str | None = None
    try:
        await operate(bench, plan, run)
    except CommandRefusedError as error:
        reason = error.fields["verdict"].reason
    refused: bool | None = None
    if reason is not None:
        await once_seen(lambda: bench.planner.plan_pose(pose.position, pose.quat_xyzw))
        refused = (await bench.planner.command("execute_motionxx", timeout=120.0)).decision == "rejected"
    reached, residual = _reached(bench)
    return FailureResult(
        run=run.run,
        workflow=setup.workflow,
        injection=run.injection,
        landmark=run.landmark,
        outcome="completed" if reason is None else "rejected",
        rejected_at=None if reason is None else NEXT_STATE.get(reached),
        residual_mm=residual,
        reason=reason,
        motion_refused=refused,
        published_rejected_at=run.rejected_at,
        published_residual_mm=run.residual_mm,
    )


async def _complete_procedure(bench: ExperimentBench, plan: Plan, _run: FailureRun) -> None:
    await bench.planner.plan_landmarks([landmark.position for landmark in plan.landmarks])
    await bench.planner.digitize_all()
    await bench.planner.register()


async def _omit_plan(bench: ExperimentBench, _plan: Plan, _run: FailureRun) -> None:
    await bench.planner.digitize_all()


async def _omit_landmark(bench: ExperimentBench, plan: Plan, run: FailureRun) -> None:
    await bench.planner.plan_landmarks([landmark.position for landmark in plan.landmarks])
    for index in range(len(plan.landmarks)):
        if index + 1 != run.landmark:
            await bench.planner.digitize_one(index)
    await bench.planner.register()


async def _displace_landmark(bench: ExperimentBench, plan: Plan, run: FailureRun) -> None:
    if run.landmark is not None and run.offset_in_image is not None:
        await bench.scene.displace_touch(run.landmark - 1, run.offset_in_image)
    await _complete_procedure(bench, plan, run)


OPERATORS: dict[str, Callable[[ExperimentBench, Plan, FailureRun], Coroutine[Any, Any, None]]] = {
    "none": _complete_procedure,
    "missing_landmark_plan": _omit_plan,
    "missing_landmark": _omit_landmark,
    "large_digitization_error": _displace_landmark,
}


def _reached(bench: ExperimentBench) -> tuple[str, float | None]:
    """Return the state of the registration after a run, and the residual of its registration, mm, from the journal."""
    rows = [stored.row for stored in bench.journal.read(kind="outcome")]
    begin = max((n for n, row in enumerate(rows) if row.operation == "reinit" and row.branch == "toolplan"), default=-1)
    residual: float | None = None
    for row in rows[begin + 1 :]:
        if row.operation == "register" and row.verdict is not None:
            fields = row.verdict.result or (row.verdict.reason.fields if row.verdict.reason else {})
            residual = fields["residual"] * 1000.0 if "residual" in fields else None
    return (rows[-1].states or {})["registration"], residual


def _limit_mm(bench: ExperimentBench) -> float:
    """Return the residual limit in force, mm, as accepted registrations report it."""
    rows = [stored.row for stored in bench.journal.read(kind="outcome", branch="registration")]
    results = [row.verdict.result for row in rows if row.verdict and row.verdict.result]
    limits = [float(result["limit"]) for result in results if "limit" in result]
    return limits[-1] * 1000.0 if limits else float("nan")
