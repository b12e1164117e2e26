"""A reference that was bumped is noticed: by a landmark touched again, or against a second body by itself."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest

from pcmrs.messages import DeviceEvent
from pcmrs.service.watches.reference import ReferenceWatch
from pcmrs.workflows.reference import BODIES, RECENT, detected_shift
from tests import ROOT
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

FEMUR: dict[str, Any] = json.loads((ROOT / "examples" / "femoroplasty_plan.json").read_text())
BUMP = (0.004, 0.0, 0.0)
TURN = (0.0, 0.0, 0.05)
"""3° about the reference's z axis."""
NOTHING = (0.0, 0.0, 0.0)
FAR_BUMP = (0.010, 0.0, 0.0)
"""More than two touches explain, so that a landmark shows it."""


@asynccontextmanager
async def watched(bench: WorkflowBench) -> AsyncIterator[None]:
    """The daemon's watch, on the bench's own dispatcher."""
    watch = asyncio.create_task(ReferenceWatch(bench.cell, bench.dispatcher).run())
    try:
        yield
    finally:
        watch.cancel()
        with suppress(asyncio.CancelledError):
            await watch


def _moved(bench: WorkflowBench) -> list[DeviceEvent]:
    return [each for each in bench.published if isinstance(each, DeviceEvent) and each.code == "reference_moved"]


async def _digitized(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")


@pytest.mark.parametrize(("offset", "rotvec"), [(BUMP, NOTHING), (NOTHING, TURN)])
async def test_bumped_reference_latches_and_revokes_the_registration(
    bench: WorkflowBench, offset: Any, rotvec: Any
) -> None:
    await bench.to_standoff()
    async with watched(bench):
        await bench.clock.sleep(2.0)
        assert not _moved(bench)
        await bench.scene.bump_reference(offset, rotvec)
        await bench.until(lambda: bench.states["registration"] == "100")
    assert bench.dispatcher.snapshot().latched
    assert (bench.states["digitization"], bench.states["placement"]) == ("0", "held")
    assert bench.data.registered is None
    assert bench.data.digitized == (None,) * len(LANDMARKS)
    assert bench.data.reference is None
    (event,) = _moved(bench)
    assert event.danger
    assert event.fields["translation"] > 0.0015 or event.fields["rotation"] > 0.0175
    assert await bench.dispatcher.stop("test:operator"), "the arm stands"
    await bench.accept("robot.acknowledge")
    await bench.accept("placement.back_off")
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")


async def test_the_motion_under_way_ends(bench: WorkflowBench) -> None:
    await bench.register()
    async with watched(bench), bench.moving("placement.approach") as approach:
        await bench.scene.bump_reference(BUMP, NOTHING)
        verdict = await approach
        await bench.until(lambda: bench.states["registration"] == "100")
    assert (verdict.decision, verdict.state) == ("failed", "held")
    assert verdict.reason is not None
    assert verdict.reason.code == "reference_moved"


async def test_a_head_that_moves_with_its_reference_is_no_bump(bench: WorkflowBench) -> None:
    await bench.register()
    async with watched(bench):
        for offset in ((0.05, 0.0, 0.0), (0.0, -0.05, 0.03), (-0.05, 0.05, -0.03)):
            await bench.scene.move_body(offset)
            await bench.clock.sleep(1.0)
    assert not _moved(bench)
    assert bench.states["registration"] == "111"


@pytest.mark.parametrize("offset", [(0.0005, 0.0, 0.0), (0.0, -0.0008, 0.0)])
async def test_displacement_within_tracker_noise_is_no_bump(bench: WorkflowBench, offset: Any) -> None:
    await bench.register()
    async with watched(bench):
        await bench.scene.bump_reference(offset, NOTHING)
        await bench.clock.sleep(3.0)
    assert not _moved(bench)


async def test_without_a_witness_nobody_watches_and_the_result_says_so(bench: WorkflowBench) -> None:
    await bench.scene.occlude("witness", True)
    await bench.clock.sleep(1.0)
    await _digitized(bench)
    told = (await bench.accept("registration.register")).result
    assert told is not None
    assert told["witness"] is False
    assert bench.data.reference is None
    await bench.scene.occlude("witness", False)
    async with watched(bench):
        await bench.scene.bump_reference(BUMP, NOTHING)
        await bench.clock.sleep(2.0)
    assert not _moved(bench)
    assert bench.states["registration"] == "111"


async def test_witness_hidden_for_a_while_is_no_bump_and_then_watched(bench: WorkflowBench) -> None:
    await bench.register()
    async with watched(bench):
        await bench.scene.occlude("witness", True)
        await bench.clock.sleep(2.0)
        assert not _moved(bench)
        await bench.scene.bump_reference(BUMP, NOTHING)
        await bench.clock.sleep(2.0)
        assert not _moved(bench)
        await bench.scene.occlude("witness", False)
        await bench.until(lambda: bench.states["registration"] == "100")


async def test_few_frames_do_not_show_that_a_reference_has_moved(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.scene.occlude("witness", True)
    await bench.clock.sleep(2.0 * RECENT)
    await bench.scene.bump_reference(BUMP, NOTHING)
    await bench.scene.occlude("witness", False)
    shown = bench.clock.monotonic()
    await bench.until(lambda: bool(bench.cell.poses.together(BODIES, shown)))
    assert len(bench.cell.poses.together(BODIES, shown)) < bench.cell.settings.registration.reference_frames
    assert detected_shift(bench.cell, bench.data) is None
    await bench.clock.sleep(RECENT)
    assert detected_shift(bench.cell, bench.data) is not None


async def test_bump_during_digitization_is_refused_at_next_landmark(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_one", index=0)
    await bench.scene.bump_reference(BUMP, NOTHING)
    verdict = await bench.refuse("digitization.digitize_one", "reference_moved", decision="failed", index=1)
    assert verdict.reason is not None
    assert verdict.reason.fields["translation"] == pytest.approx(0.004, abs=0.0005)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")


async def test_nothing_before_a_moved_reference_can_be_taken_back(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.scene.bump_reference(BUMP, NOTHING)
    await bench.clock.sleep(1.0)
    await bench.refuse("digitization.digitize_surface", "reference_moved", decision="failed")
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.refuse("digitization.reuse_previous", "reference_moved")
    await bench.refuse("registration.use_previous", "reference_moved")
    await bench.refuse("toolplan.use_previous", "reference_moved")


async def test_previous_registration_is_watched(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.accept("registration.clear_landmarks")
    await bench.accept("registration.use_previous")
    async with watched(bench):
        await bench.scene.bump_reference(BUMP, NOTHING)
        await bench.until(lambda: bench.states["registration"] == "100")


@pytest.mark.parametrize("state", ["110", "111"])
async def test_a_landmark_touched_again_is_where_it_was(bench: WorkflowBench, state: str) -> None:
    await _digitized(bench)
    if state == "111":
        await bench.accept("registration.register")
    data = bench.data
    for index in range(len(LANDMARKS)):
        told = (await bench.accept("digitization.check_landmark", index=index)).result
        assert told is not None
        assert told["distance"] <= told["limit"] == pytest.approx(0.004525, abs=1e-6)
    assert bench.states["registration"] == state
    assert bench.data == data


async def test_displaced_landmark_revokes_the_registration(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.scene.occlude("witness", True)
    await bench.scene.bump_reference(FAR_BUMP, NOTHING)
    verdict = await bench.accept("digitization.check_landmark", index=1)
    assert verdict.result is not None
    assert verdict.result["distance"] > verdict.result["limit"]
    assert verdict.state == "0"
    assert bench.states["registration"] == "100"
    assert bench.data.registered is None
    assert bench.data.digitized == (None,) * len(LANDMARKS)
    await bench.scene.occlude("witness", False)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")


async def test_a_checked_landmark_must_be_planned(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.refuse("digitization.check_landmark", "no_such_landmark", index=len(LANDMARKS))


async def test_reference_moved_while_drilling_latches_then_revokes() -> None:
    """The registration ends when the drill is out of the bone."""
    surgeon = {"surgeon": "A. Surgeon"}
    async with open_bench(workflow="femoroplasty") as bench:
        await bench.connect()
        await bench.accept("registration.plan_landmarks", landmarks=FEMUR["landmarks"])
        await bench.accept("digitization.digitize_all")
        await bench.accept("registration.register")
        await bench.accept("toolplan.plan", **FEMUR["poses"][0])
        await bench.accept("treatment.confirm_clear", **surgeon)
        await bench.accept("placement.approach")
        await bench.accept("placement.confirm")
        await bench.accept("treatment.start_drilling", **surgeon)
        async with watched(bench):
            await bench.scene.bump_reference(BUMP, NOTHING)
            await bench.until(lambda: bench.dispatcher.snapshot().latched)
            await bench.clock.sleep(2.0)
            assert (bench.states["treatment"], bench.states["registration"]) == ("drilling", "111")
            assert len(_moved(bench)) == 1
            await bench.accept("treatment.confirm_drilled", **surgeon)
            await bench.until(lambda: bench.states["registration"] == "100")
        assert bench.states["treatment"] == "abandoned"
        assert bench.states["placement"] == "held"
        await bench.accept("robot.acknowledge")
        await bench.accept("placement.back_off")


async def test_checking_a_landmark_keeps_what_needs_the_registration() -> None:
    async with open_bench(workflow="grid_mapping") as bench:
        await bench.register()
        await bench.accept("mapping.plan_grid", poses=POSES[:9])
        for _ in range(9):
            await bench.accept("mapping.skip")
        assert bench.states["mapping"] == "done"
        await bench.accept("digitization.check_landmark", index=0)
        await bench.accept("digitization.digitize_surface")
        assert bench.states["mapping"] == "done", "only a new registration opens a finished map"
