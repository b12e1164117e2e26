"""The way back from the body stays open in every shipped workflow, whatever is forgotten on the way."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform
from pcmrs.workflows.paths import body_centre
from tests import ROOT
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

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
    return bench.cell.arm.forward(bench.cell.posture()) @ bench.cell.flange_from_coil


async def clear_registration(bench: WorkflowBench) -> None:
    await bench.accept("registration.clear_registration")


async def clear_landmarks(bench: WorkflowBench) -> None:
    await bench.accept("registration.clear_landmarks")


async def clear_and_hide(bench: WorkflowBench) -> None:
    await bench.accept("registration.clear_registration")
    await bench.scene.occlude("body_ref", True)
    await bench.clock.sleep(1.0)


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
            bench.cell.image_from_coil(bench.data)
        assert unseen.value.refusal_code == "pose_stale"
        before = coil(bench)
        await bench.accept("placement.back_off")
        away = (before.inverse() @ coil(bench)).translation
        assert away == pytest.approx((0.0, 0.0, bench.cell.settings.placement.standoff), abs=0.001)


async def test_nothing_is_known_of_the_arm_before_its_first_joints(bench: WorkflowBench) -> None:
    await bench.register()
    silent = replace(bench.cell, joints=None, base_from_body_ref=None)
    for ask in (silent.posture, partial(silent.frames, bench.data), partial(silent.image_from_coil, bench.data)):
        with pytest.raises(RefusalError, match="connect it first") as refused:
            ask()
        assert refused.value.refusal_code == "joints_unknown"
