"""Following experiment: the tool keeps its place on a simulated head that moves."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass

import msgspec
import numpy as np

from pcmrs.errors import CommandRefusedError
from pcmrs.messages import HeadMotion
from pcmrs.spatial import Transform, distance
from pcmrs.workflows.data import as_transform
from pcmrs_lab.experiment.error_series import ErrorSeries, PlacementErrorMonitor
from pcmrs_lab.experiment.head_motions import Scenario, scenarios
from pcmrs_lab.experiment.placements import ASK_AGAIN, PATIENCE, PAUSE, once_seen, registered
from pcmrs_lab.experiment.private import ExperimentBench, private_bench
from pcmrs_lab.experiment.session.operator import TO_PLACED
from pcmrs_lab.experiment.setup import ExperimentSetup

ALIGNED_WITHIN = 10.0
"""Time within which a tool that follows a resting head counts as aligned, s of the machine."""
ATTEMPTS = 3
"""Number of attempts: on a busy machine the robot may miss its set points, and hold."""
OCCLUDED = 3.0
"""Time for which the reference is hidden at the end, s of the cell."""


class ErrorSummary(msgspec.Struct, frozen=True):
    """Statistics of errors over time, mm."""

    rms: float
    p99: float
    max: float


class FollowingResult(msgspec.Struct, frozen=True):
    """Result of one scenario.

    Attributes:
        compensated: True if the tracker's latency was compensated.
        true_mm: Actual pose against the plan as registered.
        measured_mm: Measured pose against the plan as registered, by the frames of the tracker.
        allowed: Share of the time in which the tool counted as aligned.
        true_allowed_mm: Largest true error in that time, mm.
        lag: Delay of the simulation behind its clock, s.
        lost: True if following ended by itself.
    """

    scenario: str
    motion: str
    compensated: bool
    true_mm: ErrorSummary
    measured_mm: ErrorSummary
    allowed: float
    true_allowed_mm: float
    lag: float
    lost: bool


class Occluded(msgspec.Struct, frozen=True):
    """State of a tool whose reference was hidden while the head breathed.

    Attributes:
        moved_mm: Displacement within `seconds` after the reference was hidden, mm.
    """

    seconds: float
    state: str
    alignment: str
    latched: bool
    moved_mm: float


class FollowingReport(msgspec.Struct, frozen=True):
    """Results of one run of the experiment."""

    experiment: str
    workflow: str
    seed: int
    rate: float
    duration: float
    settings: list[str]
    simulated: bool
    runs: list[FollowingResult]
    occlusion: Occluded


@dataclass(frozen=True, slots=True)
class Drawn:
    """Run as it is plotted."""

    result: FollowingResult
    series: ErrorSeries


async def run_following(setup: ExperimentSetup, duration: float) -> tuple[FollowingReport, list[Drawn]]:
    """Follow each kind of motion with and without compensation of the latency, each on its own daemon.

    Args:
        setup: Setup, of which the first pose is used.
        duration: Duration of each run, s of the cell.

    Returns:
        Report, and the runs for plotting.

    Raises:
        CommandRefusedError: The daemon refused a command; the text gives it and the reason.
        DeviceError: A daemon did not start.
    """
    drawn = [*await _variant(setup, duration, compensated=False), *await _variant(setup, duration, compensated=True)]
    setup.progress("occlusion", 2, 3)
    occlusion = await _occlusion(setup, duration)
    setup.progress("done", 3, 3)
    report = FollowingReport(
        experiment="following",
        workflow=setup.workflow,
        seed=setup.seed,
        rate=setup.rate,
        duration=duration,
        settings=setup.settings(),
        simulated=True,
        runs=[each.result for each in drawn],
        occlusion=occlusion,
    )
    return report, drawn


async def _variant(setup: ExperimentSetup, duration: float, *, compensated: bool) -> list[Drawn]:
    """Run all scenarios one after the other on one daemon."""
    drawn = []
    async with _bench(setup, compensated=compensated) as bench:
        monitor = await _placed(bench, setup)
        for scenario in scenarios(duration, setup.seed):
            name = f"{scenario.name}, latency {'' if compensated else 'not '}compensated"
            setup.progress(name, 1 if compensated else 0, 3)
            await _begin(bench, monitor)
            await bench.scene.set_motion(scenario.motion)
            series = await monitor.watch(duration)
            await bench.scene.set_motion(HeadMotion())
            drawn.append(Drawn(_result(scenario, series, monitor, compensated=compensated), series))
    return drawn


async def _occlusion(setup: ExperimentSetup, duration: float) -> Occluded:
    """Hide the reference of a head that breathes, while the tool follows it."""
    async with _bench(setup, compensated=True) as bench:
        monitor = await _placed(bench, setup)
        await _begin(bench, monitor)
        (breathing,) = (each for each in scenarios(duration, setup.seed) if each.name == "breathing")
        await bench.scene.set_motion(breathing.motion)
        await monitor.watch(1.0)
        await bench.scene.occlude("body_ref", True)
        where = as_transform((await bench.scene.truth()).tracker_from_coil)
        await monitor.watch(OCCLUDED, even_if_lost=True)
        moved = distance(where, as_transform((await bench.scene.truth()).tracker_from_coil))
        latched = monitor.snapshot is not None and monitor.snapshot.latched
        state, alignment = monitor.state("placement"), monitor.state("alignment")
    return Occluded(OCCLUDED, state, alignment, latched, moved * 1000.0)


def _bench(setup: ExperimentSetup, *, compensated: bool) -> AbstractAsyncContextManager[ExperimentBench]:
    own = [f"workflow={setup.workflow}", f"sim.seed={setup.seed}", *setup.settings()]
    return private_bench([*own, f"procedure.following.compensated={str(compensated).lower()}"])


async def _begin(bench: ExperimentBench, monitor: PlacementErrorMonitor) -> None:
    """Bring the tool from any state to its place, and have it follow until it counts as aligned.

    Raises:
        CommandRefusedError: A command was refused, or following ended by itself each time.
    """
    for _ in range(ATTEMPTS):
        if (snapshot := await bench.client.state()).latched:
            await bench.client.acknowledge(stop=snapshot.stop.number)
        while (state := (await bench.client.state()).branches["placement"]) != "placed":
            await _request(bench, TO_PLACED[state])
        await _request(bench, "placement.follow")
        if await monitor.aligned(ALIGNED_WITHIN):
            return
    text = f"In {ATTEMPTS} attempts to follow a resting head the tool was never aligned within "
    raise CommandRefusedError(f"{text}{ALIGNED_WITHIN:g} s: the machine is too slow or too busy. Stop other programs.")


async def _request(bench: ExperimentBench, name: str) -> None:
    """Request an operation, again if the tracker has not shown all bodies yet."""
    for _ in range(PATIENCE):
        verdict = await bench.client.call(name)
        if verdict.reason is None or verdict.decision != "rejected" or verdict.reason.code not in ASK_AGAIN:
            break
        await asyncio.sleep(PAUSE)
    if verdict.decision != "accepted":
        reason = verdict.reason.text if verdict.reason is not None else verdict.decision
        raise CommandRefusedError(f"{name} was {verdict.decision} in {verdict.state}: {reason}")


def _result(
    scenario: Scenario, series: ErrorSeries, monitor: PlacementErrorMonitor, *, compensated: bool
) -> FollowingResult:
    allowed = series.true_allowed_mm()
    return FollowingResult(
        scenario=scenario.name,
        motion=scenario.text,
        compensated=compensated,
        true_mm=_error_summary(series.true_mm),
        measured_mm=_error_summary(series.measured_mm),
        allowed=float(np.mean(series.allowed)),
        true_allowed_mm=float(allowed.max()) if len(allowed) else 0.0,
        lag=series.lag,
        lost=monitor.state("placement") != "following",
    )


def _error_summary(errors_mm: Sequence[float]) -> ErrorSummary:
    """Return the statistics; nan if there are no errors: the tool was lost before the tracker's first frame."""
    if not errors_mm:
        return ErrorSummary(math.nan, math.nan, math.nan)
    errors = np.array(errors_mm)
    rms = float(np.sqrt(np.mean(errors**2)))
    return ErrorSummary(rms, float(np.percentile(errors, 99.0)), float(errors.max()))


async def _placed(bench: ExperimentBench, setup: ExperimentSetup) -> PlacementErrorMonitor:
    """Register the head and plan the first pose; return an monitor of the tool there."""
    plan, planner = setup.plan, bench.planner
    await planner.connect()
    await planner.plan_landmarks([landmark.position for landmark in plan.landmarks])
    await planner.digitize_all()
    await planner.register()
    pose = plan.poses[0]
    await once_seen(lambda: planner.plan_pose(pose.position, pose.quat_xyzw))
    body_ref_from_image = as_transform(registered(bench).body_ref_from_image)
    planned = Transform.from_quat_xyzw(pose.position, pose.quat_xyzw)
    tool_marker_from_tool_tip = as_transform((await bench.client.setup()).tool_marker_from_tool_tip)
    desired = body_ref_from_image @ planned
    return PlacementErrorMonitor(bench.client, bench.scene, desired, tool_marker_from_tool_tip, setup.rate)
