"""Planning, digitizing and registering: what is refused, and what ends a registration."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import PoseSetting
from tests.support.trials import examples
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

COUNT = len(LANDMARKS)


def _named(points: Any) -> list[dict[str, Any]]:
    return [{"name": f"p{index}", "position": list(point)} for index, point in enumerate(points)]


async def _plan(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)


def change(bench: WorkflowBench, **changes: Any) -> None:
    bench.cell.settings = msgspec.structs.replace(bench.cell.settings, **changes)


@pytest.mark.parametrize(
    ("points", "code"),
    [
        ([], "too_few_landmarks"),
        ([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], "too_few_landmarks"),
        ([[0.0, 0.0, 0.0]] * 4, "degenerate_points"),
        ([[0.0, 0.0, 0.01 * index] for index in range(6)], "degenerate_points"),
        ([[1000.0 * value for value in landmark["position"]] for landmark in LANDMARKS], "wrong_unit"),
        ([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, float("nan"), 0.0]], "bad_arguments"),
        ([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, float("inf"), 0.0]], "bad_arguments"),
    ],
)
async def test_landmarks_that_no_registration_could_use_are_refused(
    bench: WorkflowBench, points: Any, code: str
) -> None:
    await _plan(bench)
    await bench.accept("digitization.digitize_all")
    await bench.refuse("registration.plan_landmarks", code, landmarks=_named(points))


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"landmarks": "nasion"},
        {"landmarks": [{"name": "nasion"}]},
        {"landmarks": [{"name": "nasion", "position": [0.0, 1.0]}]},
        {"landmarks": LANDMARKS, "units": "mm"},
    ],
)
async def test_malformed_plans_are_refused(bench: WorkflowBench, arguments: dict[str, Any]) -> None:
    await bench.refuse("registration.plan_landmarks", "bad_arguments", **arguments)


async def test_unplanned_landmark_is_refused_with_the_valid_range(bench: WorkflowBench) -> None:
    await _plan(bench)
    for index in (-1, COUNT, 99):
        verdict = await bench.refuse("digitization.digitize_one", "no_such_landmark", index=index)
        assert verdict.reason is not None
        assert verdict.reason.fields == {"index": index, "count": COUNT, "check": "landmark_exists"}
    for bad in (1.5, "first", None, True):
        await bench.refuse("digitization.digitize_one", "bad_arguments", index=bad)


async def test_stop_during_digitization_keeps_nothing_of_it(bench: WorkflowBench) -> None:
    await _plan(bench)
    running = asyncio.create_task(bench.do("digitization.digitize_all"))
    await bench.until(lambda: any(item.progress > 0.3 for item in bench.dispatcher.snapshot().running))
    await bench.dispatcher.stop("test")
    verdict = await running
    assert (verdict.decision, verdict.state) == ("failed", "0")
    assert bench.data.digitized == (None,) * COUNT
    await bench.accept("digitization.digitize_all")


@examples(4, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.permutations(range(COUNT)))
async def test_landmarks_may_be_digitized_in_any_order(order: list[int]) -> None:
    async with open_bench() as bench:
        await _plan(bench)
        states = [(await bench.accept("digitization.digitize_one", index=index)).state for index in order]
        assert states == ["0"] * (COUNT - 1) + ["1"]
        assert bench.states["registration"] == "110"
        await bench.accept("registration.register")


async def test_a_limit_from_the_configuration_is_the_one_that_gates() -> None:
    async with open_bench({"registration": {"samples": 4, "residual_limit_mm": 0.1}}) as bench:
        await _plan(bench)
        await bench.accept("digitization.digitize_all")
        verdict = await bench.refuse("registration.register", "residual_too_large")
        assert verdict.reason is not None
        fields = verdict.reason.fields
        assert fields["residual"] > fields["limit"] == pytest.approx(0.0001)
        assert fields["worst"] in {landmark["name"] for landmark in LANDMARKS}


async def test_redigitizing_ends_a_registration_and_revokes_standoff(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    await bench.accept("digitization.digitize_all")
    states = bench.states
    assert (states["registration"], states["digitization"], states["toolplan"]) == ("110", "1", "1")
    assert states["placement"] == "held"
    assert bench.data.registered is None
    await bench.accept("registration.register")
    assert bench.states["placement"] == "held"
    assert (await bench.accept("placement.back_off")).state == "retracted"


@pytest.mark.parametrize(
    "name",
    [
        "registration.plan_landmarks",
        "registration.clear_landmarks",
        "registration.clear_digitization",
        "registration.clear_registration",
        "digitization.redigitize_one",
        "digitization.reuse_previous",
    ],
)
async def test_whatever_ends_a_registration_revokes_the_standoff(bench: WorkflowBench, name: str) -> None:
    arguments: dict[str, Any] = {
        "registration.plan_landmarks": {"landmarks": LANDMARKS},
        "digitization.redigitize_one": {"index": 0},
    }.get(name, {})
    await bench.to_standoff()
    await bench.accept(name, **arguments)
    assert bench.states["registration"] != "111"
    assert bench.states["placement"] == "held"
    assert bench.dispatcher.snapshot().registration is None
    verdict = await bench.do("placement.confirm")
    assert verdict.decision == "rejected"


async def test_previous_digitization_serves_the_same_landmarks_only(bench: WorkflowBench) -> None:
    await _plan(bench)
    await bench.refuse("digitization.reuse_previous", "no_previous_digitization")
    await bench.accept("digitization.digitize_all")
    digitized = bench.data.digitized
    await _plan(bench)
    assert bench.data.digitized == (None,) * COUNT
    await bench.accept("digitization.reuse_previous")
    assert bench.data.digitized == digitized
    await bench.accept("digitization.reuse_previous_except", index=1)
    assert bench.data.digitized[1] != digitized[1]
    assert bench.data.digitized[2:] == digitized[2:]
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS[:-1])
    await bench.refuse("digitization.reuse_previous", "other_landmarks")
    await bench.refuse("digitization.reuse_previous_except", "other_landmarks", index=1)


async def test_previous_registration_needs_the_patient_and_calibration(bench: WorkflowBench) -> None:
    await bench.refuse("registration.use_previous", "no_previous_registration")
    await bench.register()
    registered = bench.data.registered
    assert registered is not None
    await bench.accept("registration.clear_landmarks")
    mine = bench.cell.settings
    bench.cell.settings = msgspec.structs.replace(mine, patient="somebody else")
    await bench.refuse("registration.use_previous", "other_patient")
    pointer = msgspec.structs.replace(mine.calibration.pointer_from_tip, position=(0.0, 0.0, -0.2))
    other = msgspec.structs.replace(mine.calibration, pointer_from_tip=pointer)
    mounting, bench.cell.mounting = bench.cell.mounting, Mounting.read(other)
    bench.cell.settings = mine
    await bench.refuse("registration.use_previous", "other_calibration")
    bench.cell.mounting = mounting
    verdict = await bench.accept("registration.use_previous")
    told = {"residual": registered.residual, "witness": True, "calibration": bench.cell.calibrations()}
    assert verdict.result == told
    assert bench.states["digitization"] == "1"
    assert bench.data.registered is not None
    assert bench.data.registered.body_ref_from_image == registered.body_ref_from_image
    assert bench.data.registered.id != registered.id
    await bench.accept("placement.approach")


async def test_a_new_plan_after_the_previous_registration_ends_it(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.accept("registration.use_previous")
    await _plan(bench)
    assert bench.states["registration"] == "100"
    assert bench.states["digitization"] == "0"
    await bench.accept("toolplan.plan", **POSES[0])
    assert (await bench.do("placement.approach")).decision == "rejected"
    await bench.accept("digitization.digitize_all")


@pytest.mark.parametrize("from_state", ["110", "111"])
async def test_session_can_be_reinitiated_and_repeated(bench: WorkflowBench, from_state: str) -> None:
    await _plan(bench)
    await bench.accept("digitization.digitize_all")
    if from_state == "111":
        await bench.accept("registration.register")
    await bench.accept("registration.reinit")
    await bench.accept("toolplan.reinit")
    assert bench.states["registration"] == "000"
    assert bench.states["digitization"] == "0"
    assert bench.data.landmarks == ()
    await bench.register()


async def test_previous_digitization_needs_the_patient_and_calibration(bench: WorkflowBench) -> None:
    await bench.register()
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    mine = bench.cell.settings
    bench.cell.settings = msgspec.structs.replace(mine, patient="somebody else")
    await bench.refuse("digitization.reuse_previous", "other_patient")
    other_tip = msgspec.structs.replace(mine.calibration, pointer_from_tip=PoseSetting((0.0, 0.0, -0.2)))
    mounting, bench.cell.mounting = bench.cell.mounting, Mounting.read(other_tip)
    bench.cell.settings = mine
    await bench.refuse("digitization.reuse_previous", "other_calibration")
    bench.cell.mounting = mounting
    await bench.accept("digitization.reuse_previous")
    assert bench.states["registration"] == "110"


async def test_nothing_of_another_patient_is_taken_back() -> None:
    """Nor anything of another calibration or reference."""
    async with open_bench() as bench:
        await bench.register()
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        before, mounting = bench.cell.settings, bench.cell.mounting
        other = msgspec.structs.replace
        changed: dict[str, dict[str, Any]] = {
            "other_patient": {"patient": "somebody else"},
            "other_calibration": {
                "calibration": other(before.calibration, pointer_from_tip=PoseSetting((0, 0, -0.16)))
            },
            "other_reference": {"calibration": other(before.calibration, reference_serial="R-2")},
        }
        for code, changes in changed.items():
            change(bench, **changes)
            bench.cell.mounting = Mounting.read(bench.cell.settings.calibration)
            for name in ("registration.use_previous", "digitization.reuse_previous", "toolplan.use_previous"):
                await bench.refuse(name, code)
            bench.cell.settings, bench.cell.mounting = before, mounting
        for name in ("digitization.reuse_previous", "registration.use_previous", "toolplan.use_previous"):
            await bench.accept(name)


async def test_previous_points_of_named_landmarks_are_kept(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    before = bench.data.digitized
    first, *others = LANDMARKS
    moved = [{**first, "position": [value + 0.01 for value in first["position"]]}, *others]
    await bench.accept("registration.plan_landmarks", landmarks=moved)
    verdict = await bench.refuse("digitization.reuse_previous", "other_landmarks")
    assert verdict.reason is not None
    assert verdict.reason.fields["unchanged"] == [each["name"] for each in others]
    names = [each["name"] for each in others]
    await bench.refuse("digitization.reuse_previous_of", "other_landmarks", names=[first["name"], *names])
    await bench.refuse("digitization.reuse_previous_of", "no_such_landmark", names=["nobody"])
    await bench.accept("digitization.reuse_previous_of", names=names)
    assert (bench.states["digitization"], bench.data.digitized) == ("0", (None, *before[1:]))
    await bench.accept("digitization.digitize_one", index=0)
    assert bench.states["digitization"] == "1"


async def test_all_named_landmarks_complete_the_digitization(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    before = bench.data.digitized
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.reuse_previous_of", names=[each["name"] for each in LANDMARKS])
    assert (bench.states["digitization"], bench.data.digitized) == ("1", before)


async def test_touches_of_landmarks_that_are_not_named_stay(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    before = bench.data.digitized
    first, *others = LANDMARKS
    moved = [{**first, "position": [value + 0.01 for value in first["position"]]}, *others]
    await bench.accept("registration.plan_landmarks", landmarks=moved)
    await bench.accept("digitization.digitize_one", index=0)
    touched = bench.data.digitized[0]
    assert touched is not None
    await bench.accept("digitization.reuse_previous_of", names=[others[0]["name"]])
    assert bench.data.digitized == (touched, before[1], *(None for _ in others[1:]))
    await bench.accept("digitization.reuse_previous_of", names=[each["name"] for each in others[1:]])
    assert (bench.states["digitization"], bench.data.digitized) == ("1", (touched, *before[1:]))


async def test_touches_since_a_motion_are_not_mixed_with_old_ones(bench: WorkflowBench) -> None:
    """The reference matches the previous digitization again, but not the one of this session."""
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    first, *others = LANDMARKS
    moved = [{**first, "position": [value + 0.01 for value in first["position"]]}, *others]
    await bench.accept("registration.plan_landmarks", landmarks=moved)
    await bench.scene.bump_reference((0.004, 0.0, 0.0), (0.0, 0.0, 0.0))
    await bench.clock.sleep(1.0)
    await bench.accept("digitization.digitize_one", index=0)
    kept = bench.data
    await bench.scene.bump_reference((-0.004, 0.0, 0.0), (0.0, 0.0, 0.0))
    await bench.clock.sleep(1.0)
    await bench.refuse("digitization.reuse_previous_of", "reference_moved", names=[others[0]["name"]])
    assert bench.data == kept
