"""Distances from the body: a retreat leads away from it, whatever is forgotten on the way."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform
from pcmrs.workflows._paths import body_centre, distance_from_body
from tests import ROOT
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

PLANS = {"ratms": "ratms", "grid_mapping": "ratms", "femoroplasty": "femoroplasty"}
PLACES = [("ratms", 0), ("ratms", 8), ("ratms", 11), ("grid_mapping", 3), ("femoroplasty", 0), ("femoroplasty", 8)]
"""Workflows, and poses of their plans: at 8 and 11 of the head a joint comes to its limit on the way back."""
SURGEON = {"surgeon": "A. Surgeon"}
Forget = Callable[[WorkflowBench], Awaitable[None]]


@cache
def plan(name: str) -> dict[str, Any]:
    """Landmarks and poses of the phantom that the workflow is for."""
    file = ROOT / "examples" / f"{PLANS[name]}_plan.json"
    found: dict[str, Any] = json.loads(file.read_text())
    return found


async def may_move(bench: WorkflowBench) -> None:
    if "treatment" in bench.states:
        await bench.accept("treatment.confirm_clear", **SURGEON)


async def register(bench: WorkflowBench) -> None:
    landmarks = plan(bench.dispatcher.procedure.blueprint.id)["landmarks"]
    await bench.accept("registration.plan_landmarks", landmarks=landmarks)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")


@asynccontextmanager
async def open_placed(name: str, pose: int) -> AsyncIterator[WorkflowBench]:
    async with open_bench(workflow=name) as bench:
        await may_move(bench)
        await bench.connect()
        await register(bench)
        await bench.accept("toolplan.plan", **plan(name)["poses"][pose])
        await bench.accept("placement.approach")
        await bench.accept("placement.confirm")
        yield bench


def coil(bench: WorkflowBench) -> Transform:
    """Where the tool is, by the joints, in the robot's base."""
    return bench.cell.arm.forward(bench.cell.posture()) @ bench.cell.flange_from_tool_tip


async def clear_registration(bench: WorkflowBench) -> None:
    await bench.accept("registration.clear_registration")


async def clear_landmarks(bench: WorkflowBench) -> None:
    await bench.accept("registration.clear_landmarks")


async def clear_and_hide(bench: WorkflowBench) -> None:
    await bench.accept("registration.clear_registration")
    await bench.scene.occlude("body_ref", True)
    await bench.clock.sleep(1.0)


async def test_a_retreat_that_would_lead_towards_the_body_is_refused(bench: WorkflowBench) -> None:
    await bench.to_placed()
    assert bench.cell.joints is not None
    bench.cell.initial_joints = bench.cell.joints.positions
    verdict = await bench.refuse("placement.to_initial", "distance_shrinks")
    assert verdict.reason is not None
    assert verdict.reason.fields["shrinks"] > 0.05
    assert bench.states["placement"] == "placed"


async def test_a_retreat_heeds_where_the_body_is_now(bench: WorkflowBench) -> None:
    """A posture that was clear of the body while it was away is not gone to once the body is back."""
    await bench.to_standoff()
    assert bench.cell.joints is not None
    standoff = bench.cell.joints.positions
    await bench.accept("placement.home")
    bench.cell.initial_joints = standoff
    await bench.scene.move_body((0.0, 0.9, 0.0))
    await bench.clock.sleep(0.5)
    await bench.accept("placement.to_initial")
    await bench.accept("placement.home")
    await bench.scene.move_body((0.0, -0.9, 0.0))
    await bench.clock.sleep(0.5)
    await bench.refuse("placement.to_initial", "distance_shrinks")


async def test_retracted_means_clear_of_the_body(bench: WorkflowBench) -> None:
    """Beside the axis of its plan, and after another plan, a retreat goes on until the tool is clear."""
    clearance = bench.cell.settings.placement.clearance
    await bench.to_placed()
    await bench.accept("placement.nudge", translation=[0.015, 0.0, 0.0])
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert distance_from_body(bench.cell, bench.data) > clearance
    await bench.accept("placement.approach")
    await bench.accept("toolplan.plan", **POSES[1])
    assert bench.states["placement"] == "replanned"
    assert (await bench.accept("placement.back_off")).state == "retracted"
    assert distance_from_body(bench.cell, bench.data) > clearance


async def test_a_retreat_ends_clear_of_the_body_or_is_refused(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    bench.cell.initial_joints = bench.cell.posture().tolist()
    await bench.refuse("placement.to_initial", "not_clear")
    assert bench.states["placement"] == "standoff"


async def test_way_to_the_standoff_avoids_the_body_without_a_surface() -> None:
    bare = {"body": {"surface": ""}, "placement": {"clearance": 0.14}}
    async with open_bench(bare) as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **POSES[8])
        await bench.accept("placement.approach")
        beside = bench.cell.posture().tolist()
    async with open_bench(bare, {"arm": {"home": beside}}) as bench:
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        await bench.accept("digitization.digitize_all")
        await bench.accept("registration.register")
        await bench.connect()
        assert bench.states["placement"] == "retracted"
        await bench.accept("toolplan.plan", **POSES[11])
        verdict = await bench.refuse("placement.approach", "path_near_body")
        assert verdict.reason is not None
        assert verdict.reason.fields["distance"] < 0.06, "the head is more than 60 mm thick there"
        assert verdict.reason.fields["limit"] == pytest.approx(0.153, abs=0.01)


@pytest.mark.parametrize(
    "forget", [clear_registration, pytest.param(clear_landmarks, marks=pytest.mark.nightly), clear_and_hide]
)
@pytest.mark.parametrize(("name", "pose"), PLACES)
async def test_a_registration_given_up_leaves_the_way_back_open(name: str, pose: int, forget: Forget) -> None:
    async with open_placed(name, pose) as bench:
        registered = body_centre(bench.cell, bench.data)
        await forget(bench)
        assert bench.data.registered is None
        assert np.allclose(body_centre(bench.cell, bench.data), registered, atol=1e-3), "the middle stays known"
        assert bench.states["placement"] == "held"
        await bench.accept("placement.back_off")
        assert np.linalg.norm(coil(bench).translation - registered) > bench.cell.settings.placement.clearance
        if forget is not clear_and_hide:  # nobody sees then where it is
            assert bench.states["placement"] == "retracted"


@pytest.mark.parametrize(("name", "pose"), PLACES)
async def test_way_back_after_a_restart_is_straight_past_the_reference(name: str, pose: int) -> None:
    async with open_placed(name, pose) as bench:
        posture = bench.cell.posture().tolist()
    async with open_bench(sim={"arm": {"home": posture}}, workflow=name) as bench:
        await may_move(bench)
        await bench.connect()
        assert bench.states["placement"] == "held"
        before = coil(bench)
        await bench.accept("placement.back_off")
        assert (before.inverse() @ coil(bench)).translation[2] > bench.cell.settings.placement.standoff
        if bench.states["placement"] == "held":
            assert (name, pose) in {("ratms", 8), ("ratms", 11)}, "a joint limit cuts the way short"
            await bench.refuse("placement.back_off", "body_not_registered")
        if (name, pose) == ("ratms", 11):  # home is past the reference
            refused = await bench.refuse("placement.back_off", "distance_shrinks", confirm=True)
            assert refused.reason is not None
            assert "Register the body again" in refused.reason.text
            await register(bench)
        if bench.states["placement"] == "held":
            await bench.accept("placement.back_off", confirm=True)
        assert bench.states["placement"] == "retracted"
        await bench.accept("placement.home", confirm=True)


async def test_home_avoids_the_middle_of_a_body_no_longer_registered() -> None:
    async with open_placed("ratms", 0) as bench:
        placed = bench.cell.posture().tolist()
        await bench.accept("placement.home")
        await bench.accept("registration.clear_registration")
        bench.cell.initial_joints = placed
        await bench.refuse("placement.to_initial", "distance_shrinks")


@pytest.mark.parametrize("registered", [True, False])
async def test_tool_never_seen_with_the_body_backs_off_by_standoff(registered: bool) -> None:
    """Without a registration, middle of the body and plan say nothing; with one, nobody knows where that is."""
    async with open_placed("ratms", 0) as bench:
        if not registered:
            await bench.accept("registration.clear_registration")
        await bench.scene.occlude("coil", True)
        await bench.clock.sleep(1.0)
        bench.cell.base_from_body_ref = None
        with pytest.raises(RefusalError) as unknown:
            body_centre(bench.cell, bench.data)
        assert unknown.value.refusal_code == "body_unknown"
        with pytest.raises(RefusalError) as unseen:
            bench.cell.image_from_tool_tip(bench.data)
        assert unseen.value.refusal_code == "pose_stale"
        before = coil(bench)
        await bench.accept("placement.back_off")
        away = (before.inverse() @ coil(bench)).translation
        assert away == pytest.approx((0.0, 0.0, bench.cell.settings.placement.standoff), abs=0.001)
