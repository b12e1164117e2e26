"""Placement experiment: register a phantom, then place the tool at planned poses."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import msgspec

from pcmrs.analysis.placements import Summary, summarize
from pcmrs.errors import CommandRefusedError, ConfigurationError
from pcmrs.messages import PoseMessage, SceneTruth
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.data import Registered, as_message, as_transform
from pcmrs.workflows.toolplan import ToolPose
from pcmrs_lab.experiment.private import ExperimentBench, private_bench
from pcmrs_lab.experiment.published import Reported, published
from pcmrs_lab.experiment.setup import ExperimentSetup
from pcmrs_lab.experiment.treatment import Treated, prepare, treat

T = TypeVar("T")

PATIENCE = 50
"""Number of times that a planner repeats a request on a machine that is too busy to publish or plan in time."""
ATTEMPTS = 4
"""Number of times that the tool backs off at most."""
PAUSE = 0.2
"""Pause between two requests, s of the machine."""
MISSED = ("not_converged", "correction_too_large")
"""Reasons for which a placement has not reached its target although nothing is broken: the experiment goes on."""
ASK_AGAIN = ("pose_missing", "pose_stale", "planner_late", "planner_lost")
"""Reasons for which a request is repeated: their texts say that it may be."""


class Trial(msgspec.Struct, frozen=True):
    """One placement; every error is a distance in mm or an angle in degrees.

    Attributes:
        planned: ``image_from_coil`` as planned.
        measured: ``image_from_coil`` as the tracker measured it at the target.
        translation_error_mm: Measured against planned, both from the tracker.
        true_translation_error_mm: Actual pose against the plan mapped by the estimated registration.
        target_registration_error_mm: Plan mapped by the estimated against the true registration.
        predicted_error_mm: Rms error at the target that the daemon has predicted for the plan; None if it has not.
    """

    trial: int
    translation_error_mm: float
    rotation_error_deg: float
    true_translation_error_mm: float
    true_rotation_error_deg: float
    target_registration_error_mm: float
    target_registration_error_deg: float
    planned: PoseMessage
    measured: PoseMessage
    predicted_error_mm: float | None = None


class FailedTrial(msgspec.Struct, frozen=True):
    """A placement that did not reach its target, and the reason."""

    trial: int
    reason: str


class PlacementSummary(msgspec.Struct, frozen=True):
    """Statistics of all trials that reached their targets, with the paper's values.

    Attributes:
        predicted_error_mm: Predicted rms errors at the targets; None if there were no predictions.
        failed: Number of trials that did not reach their targets.
    """

    trials: int
    translation_error_mm: Summary
    rotation_error_deg: Summary
    true_translation_error_mm: Summary
    true_rotation_error_deg: Summary
    target_registration_error_mm: Summary
    published_translation_error_mm: Reported
    published_rotation_error_deg: Reported
    predicted_error_mm: Summary | None = None
    failed: int = 0

    @property
    def success_rate(self) -> float:
        """Share of the trials that reached their targets."""
        return self.trials / (self.trials + self.failed)


class PlacementReport(msgspec.Struct, frozen=True):
    """Results of one run of the experiment.

    Attributes:
        settings: Settings that differ from the default configuration.
        tool: Name of the tool.
        residual_mm: Residual of the registration, mm.
        treatment: Operations at the last pose, in workflows that treat.
        failed: Trials that did not reach their targets.
    """

    experiment: str
    workflow: str
    seed: int
    rate: float
    settings: list[str]
    simulated: bool
    tool: str
    residual_mm: float
    trials: list[Trial]
    treatment: list[Treated]
    summary: PlacementSummary
    failed: list[FailedTrial] = []


async def run_placements(setup: ExperimentSetup, trials: int) -> PlacementReport:
    """Run the experiment on its own daemon, commanded over UDP; at the last pose the patient is treated.

    Args:
        setup: Setup; its poses are used in order, and again from the first if there are fewer than trials.
        trials: Number of placements, at least 2.

    Returns:
        Results.

    Raises:
        ConfigurationError: There are too few trials or poses, or the workflow is not among the published ones.
        CommandRefusedError: The daemon refused a command; the text gives it and the reason.
        DeviceError: The daemon did not start.
    """
    plan, progress = setup.plan, setup.progress
    if trials < 2 or not plan.poses:
        raise ConfigurationError(
            f"{trials} trials of {len(plan.poses)} poses: at least 2 trials and 1 pose are needed."
        )
    tool = published(setup.workflow).tool
    steps = 3 + trials
    progress("starting the daemon", 0, steps)
    settings = setup.settings()
    async with private_bench([f"workflow={setup.workflow}", f"sim.seed={setup.seed}", *settings]) as bench:
        progress("planning and digitizing the landmarks", 1, steps)
        await bench.planner.connect()
        await prepare(bench.client, setup.workflow)
        await bench.planner.plan_landmarks([landmark.position for landmark in plan.landmarks])
        await bench.planner.digitize_all()
        progress("registering", 2, steps)
        residual_mm = await bench.planner.register()
        registration = as_transform(registered(bench).body_ref_from_image)
        done: list[Trial] = []
        failed: list[FailedTrial] = []
        treatment: list[Treated] = []
        for number in range(1, trials + 1):
            progress(f"placing the {tool}, {number} of {trials}", 2 + number, steps)
            pose = plan.poses[(number - 1) % len(plan.poses)]
            try:
                done.append(await _place(bench, number, pose, registration))
            except CommandRefusedError as error:
                failed.append(_failed(error, number, last=number == trials and not done))
            if number == trials and (not failed or failed[-1].trial != number):
                treatment = await treat(bench.client, setup.workflow)
            await _back_off(bench)
            await once_seen(bench.planner.home)
    progress("done", steps, steps)
    return PlacementReport(
        experiment="placements",
        workflow=setup.workflow,
        seed=setup.seed,
        rate=setup.rate,
        settings=settings,
        simulated=True,
        tool=tool,
        residual_mm=residual_mm,
        trials=done,
        treatment=treatment,
        summary=summary_of(setup.workflow, done, len(failed)),
        failed=failed,
    )


def _failed(error: CommandRefusedError, number: int, *, last: bool) -> FailedTrial:
    """Return a placement that did not converge; raise any other error, and this one if no placement has succeeded."""
    verdict = error.fields["verdict"]
    if last or verdict.decision != "failed" or verdict.reason not in MISSED:
        raise error
    return FailedTrial(number, verdict.reason)


async def _place(bench: ExperimentBench, number: int, pose: ToolPose, body_ref_from_image: Transform) -> Trial:
    """Bring the tool to a pose, leave it there and measure it."""
    await once_seen(lambda: bench.planner.plan_pose(pose.position, pose.quat_xyzw))
    await once_seen(bench.planner.approach)
    placement = await once_seen(bench.planner.confirm)
    truth = await bench.scene.truth()
    planned = Transform.from_quat_xyzw(pose.position, pose.quat_xyzw)
    measured = Transform.from_quat_xyzw(placement.position, placement.quat_xyzw)
    actual, true_registration = _actual(truth, body_ref_from_image), as_transform(truth.body_ref_from_image)
    mapped, true_target = body_ref_from_image @ planned, true_registration @ planned
    return Trial(
        trial=number,
        translation_error_mm=placement.translation_error_mm,
        rotation_error_deg=placement.rotation_error_deg,
        true_translation_error_mm=distance(actual, planned) * 1000.0,
        true_rotation_error_deg=math.degrees(rotation_angle(actual, planned)),
        target_registration_error_mm=distance(mapped, true_target) * 1000.0,
        target_registration_error_deg=math.degrees(rotation_angle(mapped, true_target)),
        planned=as_message(planned),
        measured=as_message(measured),
        predicted_error_mm=_predicted(bench),
    )


def _predicted(bench: ExperimentBench) -> float | None:
    """Return the predicted rms error of the newest plan, mm; None if the daemon has not predicted any."""
    rows = [stored.row for stored in bench.journal.read(kind="outcome", branch="toolplan")]
    predicted = [row.result["tre"] for row in rows if row.result and row.result.get("tre") is not None]
    return predicted[-1] * 1000.0 if predicted else None


async def _back_off(bench: ExperimentBench) -> None:
    """Back off, and again if the tool is held there: the tracker was too late to show that it is clear of the body."""
    for _ in range(ATTEMPTS):
        await once_seen(bench.planner.back_off)
        if (await bench.client.state()).branches["placement"] != "held":
            return


async def once_seen(ask: Callable[[], Awaitable[T]]) -> T:
    """Send a request, and repeat it while it is rejected because the tracker or the planning process is late.

    Args:
        ask: Sends the request.

    Returns:
        What the accepted request returns.

    Raises:
        CommandRefusedError: The request was rejected for another reason or too often, or it has failed: a motion that
            has begun is not repeated.
    """
    for _ in range(PATIENCE):
        try:
            return await ask()
        except CommandRefusedError as error:
            verdict = error.fields["verdict"]
            if verdict.decision != "rejected" or verdict.reason not in ASK_AGAIN:
                raise
        await asyncio.sleep(PAUSE)
    return await ask()


def _actual(truth: SceneTruth, body_ref_from_image: Transform) -> Transform:
    """Return the true ``image_from_coil`` in the image as it was registered."""
    tracker_from_image = as_transform(truth.tracker_from_body_ref) @ body_ref_from_image
    return tracker_from_image.inverse() @ as_transform(truth.tracker_from_coil)


def registered(bench: ExperimentBench) -> Registered:
    """Return the registration in force from the journal."""
    rows = [stored.row for stored in bench.journal.read(kind="outcome", branch="registration")]
    registrations = [row.result["registered"] for row in rows if row.result and row.result.get("registered")]
    return msgspec.convert(registrations[-1], Registered)


def summary_of(workflow: str, trials: Sequence[Trial], failed: int = 0) -> PlacementSummary:
    """Return the statistics of one or more trials.

    Args:
        workflow: Name of the workflow.
        trials: Trials that reached their targets, at least one.
        failed: Number of the other trials.
    """

    def over_all(field: str) -> Summary:
        return summarize([getattr(trial, field) for trial in trials])

    paper = published(workflow)
    predicted = [trial.predicted_error_mm for trial in trials if trial.predicted_error_mm is not None]
    return PlacementSummary(
        trials=len(trials),
        translation_error_mm=over_all("translation_error_mm"),
        rotation_error_deg=over_all("rotation_error_deg"),
        true_translation_error_mm=over_all("true_translation_error_mm"),
        true_rotation_error_deg=over_all("true_rotation_error_deg"),
        target_registration_error_mm=over_all("target_registration_error_mm"),
        published_translation_error_mm=paper.translation_error_mm,
        published_rotation_error_deg=paper.rotation_error_deg,
        predicted_error_mm=summarize(predicted) if predicted else None,
        failed=failed,
    )
