"""A moving arm is held if it drifts into a zone, or goes to a body that is not seen."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.spatial import Floats
from pcmrs_sim.head import CENTRE, SEMI_AXES
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench
from tests.unit.workflows.zone_bench import reason


async def move_body_beside_elbow(bench: WorkflowBench) -> Floats:
    """Moves the head to 12 mm beside the elbow; returns by how much, in the tracker."""
    cell = bench.cell
    assert cell.base_from_tracker is not None
    assert cell.base_from_body_ref is not None
    assert cell.body_ref_from_image is not None
    elbow = cell.arm.joint_origins(cell.posture())[3]
    middle = cell.base_from_body_ref @ cell.body_ref_from_image @ CENTRE
    beside = elbow + np.array((0.0, cell.arm.facts.link_radius + SEMI_AXES[0] + 0.012, 0.0))
    offset = cell.base_from_tracker.rotation.T @ (beside - middle)
    await move_body(bench, offset)
    return np.asarray(offset)


async def move_body(bench: WorkflowBench, offset: Floats) -> None:
    x, y, z = offset.tolist()
    await bench.scene.move_body((x, y, z))


async def test_body_entering_a_motion_holds_it_and_allows_retreat(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    async with bench.moving("placement.confirm") as confirm:
        offset = await move_body_beside_elbow(bench)
        verdict = await confirm
    told = reason(verdict)
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "zone_entered", "held")
    assert (told["zone"], told["link"][:4]) == ("body", "link")
    assert told["distance"] < told["limit"] == pytest.approx(0.025)
    assert bench.speed() < 1e-2
    assert not bench.cell.watchers
    await move_body(bench, -offset)
    await bench.clock.sleep(0.5)
    assert (await bench.accept("placement.back_off")).state == "standoff"


async def test_an_approach_is_held_where_the_body_comes_to_the_tool(bench: WorkflowBench) -> None:
    await bench.register()
    async with bench.moving("placement.approach") as approach:
        cell = bench.cell
        assert cell.base_from_tracker is not None
        assert cell.base_from_body_ref is not None
        assert cell.body_ref_from_image is not None
        middle = cell.base_from_body_ref @ cell.body_ref_from_image @ CENTRE
        point = cell.arm.forward(cell.posture()) @ cell.flange_from_tool_tip @ np.array((0.0, 0.0, -SEMI_AXES[2]))
        await move_body(bench, cell.base_from_tracker.rotation.T @ (point - middle))
        verdict = await approach
    told = reason(verdict)
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "zone_entered", "held")
    assert told["link"] in ("tool", "mount")
    assert told["distance"] < told["limit"] == pytest.approx(0.025)
    assert bench.speed() < 1e-2


@pytest.mark.parametrize("name", ["placement.approach", "placement.confirm", "placement.nudge"])
async def test_motion_towards_an_unseen_body_is_held_without_a_latch(name: str) -> None:
    async with open_bench({"motion": {"linear_velocity": 0.02, "near_velocity": 0.01}}) as bench:
        await (bench.register() if name == "placement.approach" else bench.to_standoff())
        arguments = {"translation": [0.0, 0.0, 0.019]} if name == "placement.nudge" else {}
        async with bench.moving(name, faster_than=0.005, **arguments) as motion:
            await bench.scene.occlude("body_ref", True)
            hidden = bench.clock.monotonic()
            verdict = await motion
        assert verdict.reason is not None
        assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "body_not_seen", "held")
        assert bench.clock.monotonic() - hidden < 0.8, "0.5 s, and the time to brake"
        assert not bench.dispatcher.snapshot().latched
        assert bench.speed() < 1e-3
        # A retreat needs nobody to see the body.
        await bench.accept("placement.back_off")


async def test_a_body_hidden_for_a_moment_holds_nothing() -> None:
    async with open_bench({"motion": {"linear_velocity": 0.02, "near_velocity": 0.01}}) as bench:
        await bench.register()
        async with bench.moving("placement.approach", faster_than=0.005) as approach:
            for _ in range(3):
                await bench.scene.occlude("body_ref", True)
                await bench.clock.sleep(0.35)
                await bench.scene.occlude("body_ref", False)
                await bench.clock.sleep(0.1)
            assert (await approach).decision == "accepted"


async def test_how_long_a_body_may_be_hidden_is_configured() -> None:
    slow = {"motion": {"linear_velocity": 0.02, "near_velocity": 0.01}, "tracking": {"unseen": 2.0}}
    async with open_bench(slow) as bench:
        await bench.register()
        async with bench.moving("placement.approach", faster_than=0.005) as approach:
            await bench.scene.occlude("body_ref", True)
            await bench.clock.sleep(1.5)
            await bench.scene.occlude("body_ref", False)
            assert (await approach).decision == "accepted"
