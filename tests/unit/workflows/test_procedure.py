"""The whole procedure, and what its results are."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.workflow_bench import DYNAMICS, LANDMARKS, POSES, WorkflowBench, open_bench


async def test_every_step_of_the_procedure_once() -> None:
    async with open_bench(sim=DYNAMICS) as bench:
        registered = await bench.register()
        assert bench.states == {
            "registration": "111",
            "digitization": "1",
            "toolplan": "1",
            "robot": "1",
            "placement": "retracted",
            "alignment": "0",
            "teleoperation": "off",
        }
        assert registered.result is not None
        assert 0.0 < registered.result["residual"] < registered.result["limit"]
        assert len(registered.result["distances"]) == len(LANDMARKS)
        assert (await bench.accept("placement.approach")).state == "standoff"
        assert await bench.true_height() == pytest.approx(0.070, abs=0.001)
        placed = await bench.accept("placement.confirm")
        assert placed.state == "placed"
        assert placed.result is not None
        assert placed.result["translation_error"] < 0.0005
        assert np.degrees(placed.result["rotation_error"]) < 0.2
        assert await bench.true_height() == pytest.approx(0.0, abs=0.001)
        assert (await bench.accept("placement.back_off")).state == "standoff"
        assert (await bench.accept("placement.home")).state == "retracted"
        assert (await bench.accept("placement.approach")).state == "standoff"
        assert (await bench.accept("placement.to_initial")).state == "retracted"
        assert (await bench.accept("robot.disconnect")).state == "0"
        assert bench.states["placement"] == "unknown"


async def test_registration_and_placement_are_exact_without_errors() -> None:
    exact = {
        "tracker": {"jitter_mm": 0.0, "bias_mm": 0.0, "bias_deg": 0.0},
        "digitization": {"planning_bias_mm": 0.0, "noise_mm": 0.0, "reach_time": 0.05, "rest_time": 0.05},
    }
    async with open_bench(sim=exact) as bench:
        registered = await bench.register()
        assert registered.result is not None
        assert registered.result["residual"] < 1e-6
        truth = as_transform((await bench.scene.truth()).body_ref_from_image)
        assert bench.data.registered is not None
        estimated = as_transform(bench.data.registered.body_ref_from_image)
        assert _difference(truth, estimated) < 1e-6
        await bench.accept("placement.approach")
        placed = await bench.accept("placement.confirm")
        assert placed.result is not None
        assert placed.result["translation_error"] < 5e-5
        image_from_coil = Transform.from_quat_xyzw(
            placed.result["measured"]["position"], placed.result["measured"]["quat_xyzw"]
        )
        planned = Transform.from_quat_xyzw(POSES[0]["position"], POSES[0]["quat_xyzw"])
        assert _difference(planned, image_from_coil) < 5e-4


async def test_plan_and_connection_may_precede_the_registration(bench: WorkflowBench) -> None:
    """They may come during it, too."""
    await bench.accept("toolplan.plan", **POSES[1])
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    for index in (3, 0, 5, 1):
        assert (await bench.accept("digitization.digitize_one", index=index)).state == "0"
    await bench.connect()
    assert (await bench.accept("digitization.digitize_one", index=2)).state == "0"
    assert (await bench.accept("digitization.digitize_one", index=4)).state == "1"
    await bench.accept("registration.register")
    assert (await bench.accept("placement.approach")).state == "standoff"


async def test_intents_are_journalled_for_what_touches_the_world(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    intents = [name for kind, name in bench.recorder.rows if kind == "intent"]
    assert intents == ["connect", "locate", "digitize_all", "approach"]


def _difference(a: Transform, b: Transform) -> float:
    return float(np.abs(a.matrix - b.matrix).max())
