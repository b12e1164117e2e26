"""Points of the skin refine a registration, or are refused; and they go with the digitization."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import pytest_asyncio

from pcmrs.messages import Command
from pcmrs.spatial import distance
from pcmrs.workflows.data import as_transform
from pcmrs_sim import head
from tests import ROOT
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

ENOUGH = 25
UNCHANGED = pytest.mark.asyncio(loop_scope="module")
"""For tests that change nothing, and so share a cell."""


@asynccontextmanager
async def _digitized() -> AsyncIterator[WorkflowBench]:
    async with open_bench() as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.accept("digitization.digitize_surface")
        yield bench


@asynccontextmanager
async def _touched() -> AsyncIterator[WorkflowBench]:
    async with open_bench() as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.accept("toolplan.plan", **POSES[0])
        told = await bench.accept("digitization.digitize_surface", points=ENOUGH)
        assert told.result is not None
        assert told.result["points"] == ENOUGH
        yield bench


@pytest.fixture
async def digitized() -> AsyncIterator[WorkflowBench]:
    """A digitized head, and one point of the skin."""
    async with _digitized() as bench:
        yield bench


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def shared_digitized() -> AsyncIterator[WorkflowBench]:
    async with _digitized() as bench:
        yield bench


@pytest.fixture
async def touched() -> AsyncIterator[WorkflowBench]:
    """A digitized head, a plan, and enough points of the skin."""
    async with _touched() as bench:
        yield bench


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def shared_touched() -> AsyncIterator[WorkflowBench]:
    async with _touched() as bench:
        yield bench


async def _true_error(bench: WorkflowBench) -> float:
    """How far the planned pose is truly off in body_ref, m."""
    assert bench.data.registered is not None
    assert bench.data.plan is not None
    image_from_coil = as_transform(bench.data.plan)
    true = as_transform((await bench.scene.truth()).body_ref_from_image)
    return distance(as_transform(bench.data.registered.body_ref_from_image) @ image_from_coil, true @ image_from_coil)


@UNCHANGED
async def test_points_are_touched_on_the_true_skin(shared_touched: WorkflowBench) -> None:
    image_from_body_ref = as_transform((await shared_touched.scene.truth()).body_ref_from_image).inverse()
    points = image_from_body_ref @ np.array(shared_touched.data.surface)
    off = np.array([np.linalg.norm(point - head.surface_point(point - head.CENTRE)) for point in points])
    assert 0.0001 < np.sqrt(np.mean(off**2)) < 0.0012
    assert np.unique(points.round(6), axis=0).shape == points.shape


async def test_refinement_is_better_at_the_target_as_predicted() -> None:
    """The true error falls, too."""
    gains = []
    for seed in (1, 2):
        async with open_bench(sim={"seed": seed}) as bench:
            await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
            await bench.accept("digitization.digitize_all")
            await bench.accept("toolplan.plan", **POSES[0])
            await bench.accept("registration.register")
            before = await _true_error(bench)
            await bench.accept("digitization.digitize_surface", points=ENOUGH)
            told = (await bench.accept("registration.refine")).result
            assert told is not None
            assert told["tre"] < 0.7 * told["tre_before"]
            assert told["landmarks"]["tre"] == pytest.approx(told["tre_before"], rel=0.2)
            assert "residual" not in told, "the wire has no number for it"
            gains.append((before, await _true_error(bench)))
    assert sum(after**2 for _, after in gains) < 0.5 * sum(before**2 for before, _ in gains)


async def test_refined_registration_is_in_force_and_gates_plans(touched: WorkflowBench) -> None:
    """The gate compares the error that it predicts."""
    told = (await touched.accept("registration.refine")).result
    assert told is not None
    assert touched.states["registration"] == "111"
    registered = touched.data.registered
    assert registered is not None
    assert len(registered.covariance) == 36
    planned = (await touched.accept("toolplan.plan", **POSES[0])).result
    assert planned is not None
    assert planned["tre"] == pytest.approx(told["tre"])
    await touched.connect()
    await touched.accept("placement.approach")


async def test_the_gates_of_the_landmarks_hold_for_a_refinement_too(touched: WorkflowBench) -> None:
    await touched.scene.displace_touch(2, (0.03, 0.0, 0.0))
    await touched.accept("digitization.digitize_all")
    await touched.accept("digitization.digitize_surface", points=ENOUGH)
    await touched.refuse("registration.refine", "landmark_outlier")


async def test_too_few_points_are_refused(digitized: WorkflowBench) -> None:
    await digitized.refuse("registration.refine", "too_few_surface_points")
    await digitized.accept("registration.register")
    before = digitized.data.registered
    await digitized.refuse("registration.refine", "too_few_surface_points")
    assert digitized.data.registered == before


@UNCHANGED
async def test_useless_refinement_is_refused_with_both_values(
    shared_touched: WorkflowBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = shared_touched.cell.settings
    noisy = msgspec.structs.replace(mine.registration, surface_sigma_mm=60.0)
    monkeypatch.setattr(shared_touched.cell, "settings", msgspec.structs.replace(mine, registration=noisy))
    verdict = await shared_touched.refuse("registration.refine", "tre_not_lowered")
    assert verdict.reason is not None
    assert verdict.reason.fields["tre_after"] > 0.98 * verdict.reason.fields["tre_before"]
    assert shared_touched.states["registration"] == "110"


@UNCHANGED
async def test_offsets_and_coverage_are_reported(shared_touched: WorkflowBench) -> None:
    """A dry run has them, too, so that a display can follow the touches."""
    command = Command(id="dry", branch="registration", operation="refine", source="test:user", arguments={})
    told = (await shared_touched.dispatcher.dry_run(command)).result
    hair, face = told["offsets"]
    assert (hair["region"], face["region"]) == ("hair", "face")
    assert hair["points"] + face["points"] == told["inliers"]
    for offset in (hair, face):
        assert abs(offset["value"]) < 3.0 * offset["deviation"] < 0.004
    coverage = told["coverage"]
    assert sum(each["points"] for each in coverage["regions"]) <= ENOUGH
    assert coverage["tre"] == pytest.approx(told["tre"], rel=0.15)
    assert coverage["regions"][0]["tre"] < coverage["tre"]
    assert coverage["advice"].startswith("20 points ")


@UNCHANGED
async def test_a_refusal_says_which_points_would_help(shared_digitized: WorkflowBench) -> None:
    verdict = await shared_digitized.refuse("registration.refine", "too_few_surface_points")
    assert verdict.reason is not None
    coverage = verdict.reason.fields["coverage"]
    assert coverage["advice"] in verdict.reason.text
    assert coverage["regions"][0]["tre"] < coverage["tre"]


@UNCHANGED
async def test_an_offset_out_of_range_is_refused_with_it(
    shared_touched: WorkflowBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = shared_touched.cell.settings
    narrow = msgspec.structs.replace(mine.registration, surface_hair_mm=0.0, surface_offset_limit_mm=1e-6)
    monkeypatch.setattr(shared_touched.cell, "settings", msgspec.structs.replace(mine, registration=narrow))
    verdict = await shared_touched.refuse("registration.refine", "surface_offset_too_large")
    assert verdict.reason is not None
    assert abs(verdict.reason.fields["offset"]) > verdict.reason.fields["limit"]


@UNCHANGED
@pytest.mark.parametrize("name", ["no_such.ply", "", "/", "../../../etc/passwd", "C:\\skins\\"])
async def test_an_unknown_surface_is_refused(shared_digitized: WorkflowBench, name: str) -> None:
    await shared_digitized.refuse("registration.refine", "unknown_surface", surface=name)


@UNCHANGED
@pytest.mark.parametrize("name", ["head_phantom.ply", "/home/lab/head_phantom.ply", "C:\\lab\\head_phantom.ply"])
async def test_of_a_path_only_the_base_name_counts(shared_digitized: WorkflowBench, name: str) -> None:
    await shared_digitized.refuse("registration.refine", "too_few_surface_points", surface=name)


@UNCHANGED
async def test_a_surface_of_another_body_is_refused(shared_touched: WorkflowBench) -> None:
    await shared_touched.refuse("registration.refine", "surface_far", surface="femur_phantom.ply")


async def test_a_file_that_is_no_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "skin.stl").write_text("not a mesh")
    async with open_bench({"body": {"folders": [str(tmp_path)]}}) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.refuse("registration.refine", "bad_file", surface="skin.stl")


async def test_points_are_taken_back_one_by_one_or_all(touched: WorkflowBench) -> None:
    points = touched.data.surface
    await touched.accept("digitization.clear_surface_point")
    assert touched.data.surface == points[:-1]
    await touched.accept("digitization.clear_surface")
    assert touched.data.surface == ()
    await touched.refuse("digitization.clear_surface_point", "no_surface_points")


LOSSES: list[tuple[str, dict[str, Any]]] = [
    ("digitization.digitize_all", {}),
    ("digitization.redigitize_one", {"index": 0}),
    ("digitization.reuse_previous", {}),
    ("registration.clear_digitization", {}),
    ("registration.plan_landmarks", {"landmarks": LANDMARKS}),
]


@pytest.mark.parametrize(("name", "arguments"), LOSSES)
async def test_points_go_with_the_digitization(digitized: WorkflowBench, name: str, arguments: dict[str, Any]) -> None:
    await digitized.accept(name, **arguments)
    assert digitized.data.surface == ()


async def test_touching_the_skin_changes_nothing_else(bench: WorkflowBench) -> None:
    await bench.register()
    states, registered = bench.states, bench.data.registered
    await bench.accept("digitization.digitize_surface", points=2)
    assert (bench.states, bench.data.registered) == (states, registered)
    await bench.accept("digitization.clear_surface")
    assert (bench.states, bench.data.registered) == (states, registered)


async def test_nobody_touches_the_skin_while_the_tool_is_at_the_head(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.refuse("digitization.digitize_surface", "tool_near_patient")
    await bench.refuse("digitization.check_landmark", "tool_near_patient", index=0)
    await bench.accept("placement.home")
    await bench.accept("digitization.digitize_surface")


async def test_tool_does_not_move_while_the_skin_is_touched(bench: WorkflowBench) -> None:
    await bench.register()
    touching = asyncio.create_task(bench.do("digitization.digitize_surface", points=20))
    await bench.until(lambda: any(item.operation == "digitize_surface" for item in bench.dispatcher.snapshot().running))
    await bench.refuse("placement.approach", "busy")
    assert (await touching).decision == "accepted"


@pytest.mark.parametrize("points", [0, 501, -1, 1.5])
async def test_a_silly_number_of_points_is_refused(bench: WorkflowBench, points: float) -> None:
    await bench.refuse("digitization.digitize_surface", "bad_arguments", points=points)


async def test_a_pointer_that_is_hidden_touches_nothing(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.scene.occlude("pointer", True)
    await bench.refuse("digitization.digitize_surface", "pose_missing", decision="failed", points=3)
    assert bench.data.surface == ()


async def test_a_bone_is_refined_as_a_head_is() -> None:
    async with open_bench(workflow="femoroplasty") as bench:
        plan = msgspec.json.decode((ROOT / "examples" / "femoroplasty_plan.json").read_bytes())
        await bench.accept("registration.plan_landmarks", landmarks=plan["landmarks"])
        await bench.accept("digitization.digitize_all")
        await bench.accept("digitization.digitize_surface", points=ENOUGH)
        told = (await bench.accept("registration.refine")).result
        assert told is not None
        assert told["tre"] < told["tre_before"]
        assert told["offsets"] == [], "bare bone has no hair"


async def test_refinement_needs_a_surface_that_is_configured_or_named() -> None:
    async with open_bench({"body": {"surface": ""}}) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.accept("digitization.digitize_surface", points=ENOUGH)
        verdict = await bench.refuse("registration.refine", "unknown_surface")
        assert verdict.reason is not None
        assert "set procedure.body.surface, or name one" in verdict.reason.text
        await bench.accept("registration.refine", surface="head_phantom.ply")


CLOUD = 100


async def test_one_slide_takes_a_cloud_of_points_that_are_apart(digitized: WorkflowBench) -> None:
    beeps: list[int] = []
    digitized.cell.beep = beeps.append
    told = await digitized.accept("digitization.digitize_surface", points=CLOUD, slide=True)
    assert told.result is not None
    assert told.result["points"] == CLOUD + 1
    points = np.array(digitized.data.surface)[1:]
    apart = np.linalg.norm(points[:, None] - points[None, :], axis=2) + np.eye(CLOUD)
    assert apart.min() >= 0.002
    assert beeps == [3, 2, 5]
    refined = await digitized.do("registration.refine")
    assert refined.reason is None or refined.reason.code != "too_few_surface_points"


async def test_a_tip_that_rests_gives_no_cloud(digitized: WorkflowBench, monkeypatch: pytest.MonkeyPatch) -> None:
    pointer = digitized.cell.pointer
    monkeypatch.setattr(pointer, "slide", pointer.touch_surface)
    before = digitized.data.surface
    await digitized.refuse(
        "digitization.digitize_surface", "cloud_incomplete", decision="failed", points=CLOUD, slide=True
    )
    assert digitized.data.surface == before
