"""The placement experiment: register a phantom, then place the tool at planned poses."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence

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

PATIENCE = 50
"""So often a planner asks again on a machine that is too busy to show poses in time."""
PAUSE = 0.2
"""Between two of these, s of the machine."""
NOT_SEEN = ("pose_missing", "pose_stale")
"""Reasons for which it does."""


class Trial(msgspec.Struct, frozen=True):
    """One placement; every error is a distance in mm or an angle in degrees.

    Attributes:
        planned: ``image_from_coil`` as planned.
        measured: ``image_from_coil`` as the tracker measured it at the target.
        translation_error_mm: Measured against planned, all from the tracker.
        true_translation_error_mm: The actual pose against the plan mapped by the estimated registration.
        target_registration_error_mm: The plan mapped by the estimated against the true registration.
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


class PlacementSummary(msgspec.Struct, frozen=True):
    """All trials, beside what the paper has."""

    trials: int
    translation_error_mm: Summary
    rotation_error_deg: Summary
    true_translation_error_mm: Summary
    true_rotation_error_deg: Summary
    target_registration_error_mm: Summary
    published_translation_error_mm: Reported
    published_rotation_error_deg: Reported


class PlacementReport(msgspec.Struct, frozen=True):
    """Results of one run of the experiment.

    Attributes:
        settings: What differs from the default configuration.
        tool: What was placed.
        residual_mm: Of the registration.
        treatment: What was done at the last pose, in workflows that treat.
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


async def run_placements(setup: ExperimentSetup, trials: int) -> PlacementReport:
    """Runs the experiment through a daemon of its own, commanded over UDP; at the last pose the patient is treated.

    Args:
        setup: Its poses are taken in order, again from the first when there are fewer than trials.
        trials: How many placements.

    Raises:
        ConfigurationError: There are no trials or poses, or the workflow was not published.
        CommandRefusedError: The daemon refused a command; the text says which and why.
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
        treatment: list[Treated] = []
        for number in range(1, trials + 1):
            progress(f"placing the {tool}, {number} of {trials}", 2 + number, steps)
            pose = plan.poses[(number - 1) % len(plan.poses)]
            done.append(await _place(bench, number, pose, registration))
            if number == trials:
                treatment = await treat(bench.client, setup.workflow)
            await bench.planner.back_off()
            await bench.planner.home()
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
        summary=summary_of(setup.workflow, done),
    )


async def _place(bench: ExperimentBench, number: int, pose: ToolPose, body_ref_from_image: Transform) -> Trial:
    """Brings the tool to a pose, leaves it there and measures it."""
    await once_seen(lambda: bench.planner.plan_pose(pose.position, pose.quat_xyzw))
    await once_seen(bench.planner.approach)
    placement = await bench.planner.confirm()
    truth = await bench.scene.truth()
    planned = Transform.from_quat_xyzw(pose.position, pose.quat_xyzw)
    measured = Transform.from_quat_xyzw(placement.position, placement.quat_xyzw)
    actual, true_registration = _actual(truth, body_ref_from_image), as_transform(truth.body_ref_from_image)
    mapped, meant = body_ref_from_image @ planned, true_registration @ planned
    return Trial(
        trial=number,
        translation_error_mm=placement.translation_error_mm,
        rotation_error_deg=placement.rotation_error_deg,
        true_translation_error_mm=distance(actual, planned) * 1000.0,
        true_rotation_error_deg=math.degrees(rotation_angle(actual, planned)),
        target_registration_error_mm=distance(mapped, meant) * 1000.0,
        target_registration_error_deg=math.degrees(rotation_angle(mapped, meant)),
        planned=as_message(planned),
        measured=as_message(measured),
    )


async def once_seen(ask: Callable[[], Awaitable[None]]) -> None:
    """Asks, and asks again where that was refused because the tracker has not shown yet where all is at rest."""
    for _ in range(PATIENCE):
        try:
            return await ask()
        except CommandRefusedError as error:
            if error.fields["verdict"].reason not in NOT_SEEN:
                raise
        await asyncio.sleep(PAUSE)
    return await ask()


def _actual(truth: SceneTruth, body_ref_from_image: Transform) -> Transform:
    """``image_from_coil`` as it really is, in the image as it was registered."""
    tracker_from_image = as_transform(truth.tracker_from_body_ref) @ body_ref_from_image
    return tracker_from_image.inverse() @ as_transform(truth.tracker_from_coil)


def registered(bench: ExperimentBench) -> Registered:
    """The registration in force, as the journal has it."""
    rows = [stored.row for stored in bench.journal.read(kind="outcome", branch="registration")]
    kept = [row.result["registered"] for row in rows if row.result and row.result.get("registered")]
    return msgspec.convert(kept[-1], Registered)


def summary_of(workflow: str, trials: Sequence[Trial]) -> PlacementSummary:
    """Of one or more trials of a workflow."""

    def over_all(field: str) -> Summary:
        return summarize([getattr(trial, field) for trial in trials])

    paper = published(workflow)
    return PlacementSummary(
        trials=len(trials),
        translation_error_mm=over_all("translation_error_mm"),
        rotation_error_deg=over_all("rotation_error_deg"),
        true_translation_error_mm=over_all("true_translation_error_mm"),
        true_rotation_error_deg=over_all("true_rotation_error_deg"),
        target_registration_error_mm=over_all("target_registration_error_mm"),
        published_translation_error_mm=paper.translation_error_mm,
        published_rotation_error_deg=paper.rotation_error_deg,
    )
