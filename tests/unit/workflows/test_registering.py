"""The verdict decides: what is refused and how it is named, what a registration tells, and what it learns of noise."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.messages import Verdict
from pcmrs.registration import NoiseEstimate
from pcmrs.workflows.accuracy import active_noise_sigma, pointer_id
from pcmrs.workflows.data import PlacementData, as_transform
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

NAMES = [landmark["name"] for landmark in LANDMARKS]
POSITIONS = np.array([landmark["position"] for landmark in LANDMARKS])
GATES = ["wrong_unit", "mirrored", "swapped_landmarks", "landmark_outlier", "residual_too_large", "tre_too_large"]


async def _digitized(bench: WorkflowBench, landmarks: list[dict[str, Any]] = LANDMARKS) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=landmarks)
    await bench.accept("digitization.digitize_all")


async def _displaced(bench: WorkflowBench, touched: np.ndarray[Any, Any]) -> None:
    """Digitizes with the tip at other points of the image than planned, m, (N, 3)."""
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    for index, offset in enumerate(touched - POSITIONS):
        x, y, z = offset.tolist()
        await bench.scene.displace_touch(index, (x, y, z))
    await bench.accept("digitization.digitize_all")


def _result(verdict: Verdict) -> dict[str, Any]:
    assert verdict.result is not None
    return verdict.result


def _fields(verdict: Verdict) -> dict[str, Any]:
    assert verdict.reason is not None
    return verdict.reason.fields


async def test_an_accepted_registration_tells_all_that_was_asked_of_it(bench: WorkflowBench) -> None:
    await _digitized(bench)
    told = _result(await bench.accept("registration.register"))
    assert [gate["name"] for gate in told["gates"]] == GATES
    assert all(gate["accepted"] for gate in told["gates"])
    assert told["target"] == {"at": "centroid", "position": pytest.approx(tuple(POSITIONS.mean(axis=0)))}
    assert told["sigma"] == pytest.approx(0.00186)
    assert told["witness"] is True
    assert told["limit"] == pytest.approx(0.004)
    assert told["residual"] == pytest.approx(np.mean(told["distances"]))
    assert told["rms"] == pytest.approx(np.sqrt(np.mean(np.square(told["distances"]))))
    assert bench.data.registered is not None
    assert bench.data.registered.residual == pytest.approx(told["residual"])


async def test_each_landmark_tells_how_still_the_pointer_was_held(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    spreads = _result(await bench.accept("digitization.digitize_all"))["spreads"]
    assert list(spreads) == NAMES
    assert all(0.0 < spread < 0.001 for spread in spreads.values())
    await bench.accept("digitization.redigitize_one", index=1)
    assert list(_result(await bench.accept("digitization.digitize_one", index=1))["spreads"]) == [NAMES[1]]


async def test_displaced_landmark_is_named_though_residual_would_pass(bench: WorkflowBench) -> None:
    touched = POSITIONS.copy()
    touched[2, 0] += 0.012
    await _displaced(bench, touched)
    fields = _fields(await bench.refuse("registration.register", "landmark_outlier"))
    assert fields["suspect"] == NAMES[2]
    assert fields["residual"] < 0.004
    assert bench.data.registered is None
    await bench.accept("digitization.redigitize_one", index=2)
    await bench.accept("digitization.digitize_one", index=2)
    await bench.accept("registration.register")


async def test_swapped_landmarks_are_named(bench: WorkflowBench) -> None:
    touched = POSITIONS.copy()
    touched[[0, 4]] = touched[[4, 0]]
    await _displaced(bench, touched)
    verdict = await bench.refuse("registration.register", "swapped_landmarks")
    assert verdict.reason is not None
    assert f"{NAMES[0]} and {NAMES[4]} are exchanged" in verdict.reason.text
    order = NAMES.copy()
    order[0], order[4] = order[4], order[0]
    assert verdict.reason.fields["order"] == order


async def test_left_and_right_exchanged_is_named_as_mirrored(bench: WorkflowBench) -> None:
    await _displaced(bench, POSITIONS * [-1.0, 1.0, 1.0])
    verdict = await bench.do("registration.register")
    assert verdict.reason is not None
    assert verdict.reason.code in ("mirrored", "swapped_landmarks")  # a head is nearly its own mirror image


async def test_a_plan_in_force_is_where_the_error_matters(bench: WorkflowBench) -> None:
    await bench.accept("toolplan.plan", **POSES[0])
    await _digitized(bench)
    told = _result(await bench.accept("registration.register"))
    assert told["target"] == {"at": "plan", "position": tuple(POSES[0]["position"])}
    await bench.accept("toolplan.clear")
    at_centroid = _result(await bench.accept("registration.register"))
    assert at_centroid["target"]["at"] == "centroid"
    assert at_centroid["tre"] < told["tre"]


async def test_target_error_gates_registering_planning_and_approaching() -> None:
    far: dict[str, Any] = {"position": [0.0, 0.6, 0.5], "quat_xyzw": POSES[0]["quat_xyzw"]}
    async with open_bench() as bench:
        await bench.accept("toolplan.plan", **far)
        await _digitized(bench)
        fields = _fields(await bench.refuse("registration.register", "tre_too_large"))
        assert fields["value"] > fields["limit"] == pytest.approx(0.004)
        await bench.accept("toolplan.clear")
        await bench.accept("registration.register")
        fields = _fields(await bench.refuse("toolplan.plan", "tre_too_large", **far))
        assert fields["tre"] > fields["limit"] == pytest.approx(0.004)
        planned = _result(await bench.accept("toolplan.plan", **POSES[0]))
        assert planned["tre"] < 0.004
        await bench.connect()
        strict = msgspec.structs.replace(bench.cell.settings.registration, tre_limit_mm=0.001 + planned["tre"] * 500)
        bench.cell.settings = msgspec.structs.replace(bench.cell.settings, registration=strict)
        await bench.refuse("placement.approach", "tre_too_large")


async def test_a_registration_teaches_the_noise_of_its_pointer_once(bench: WorkflowBench) -> None:
    await _digitized(bench)
    first = _result(await bench.accept("registration.register"))
    pointer = pointer_id(bench.cell)
    learned = bench.data.noise
    assert learned[pointer].degrees == 3 * len(LANDMARKS) - 6
    assert learned[pointer].sum_of_squares == pytest.approx(float(np.sum(np.square(first["distances"]))))
    second = _result(await bench.accept("registration.register"))
    assert bench.data.noise == learned, "the same plan counts once"
    assert second["sigma"] == pytest.approx(active_noise_sigma(bench.cell, bench.data))
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")
    assert bench.data.noise == learned, "digitized anew or not"
    await _digitized(bench, LANDMARKS[:-1])
    await bench.accept("registration.register")
    assert bench.data.noise[pointer].degrees == 12 + 9
    await bench.accept("registration.reinit")
    assert bench.data.noise[pointer].degrees == 12 + 9


async def test_bad_sets_do_not_teach_the_workflow_to_accept_them() -> None:
    """Whoever goes on registering sets at the edge of the limits is refused what was refused before."""
    async with open_bench({"registration": {"samples": 4, "sigma_degrees": 1.0}}) as bench:
        bench.dispatcher.procedure.data = PlacementData(noise={pointer_id(bench.cell): NoiseEstimate(1.0, 10_000)})
        touched = POSITIONS.copy()
        touched[3] += [0.0, 0.020, 0.0]
        await _displaced(bench, touched)
        verdict = await bench.do("registration.register")
        assert verdict.decision == "rejected"


async def test_femur_has_its_own_limits() -> None:
    async with open_bench(workflow="femoroplasty") as bench:
        settings = bench.cell.settings.registration
        assert (settings.residual_limit_mm, settings.sigma_mm, settings.tre_limit_mm) == (2.7, 1.03, 3.0)
        assert settings.retouch_sigma_mm == 0.52


async def test_the_registration_in_force_maps_the_landmarks_as_it_says(bench: WorkflowBench) -> None:
    await bench.register()
    registered = bench.data.registered
    assert registered is not None
    mapped = as_transform(registered.body_ref_from_image) @ POSITIONS
    distances = np.linalg.norm(mapped - np.array(registered.digitized), axis=1)
    assert registered.residual == pytest.approx(distances.mean())
