"""Registration, digitization and plan are taken back on an operator's word only, and only where they still belong."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.workflows.settings import PoseSetting
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench


def change(bench: WorkflowBench, **changes: Any) -> None:
    bench.cell.settings = msgspec.structs.replace(bench.cell.settings, **changes)


async def test_last_plan_is_taken_back_under_its_own_id(bench: WorkflowBench) -> None:
    await bench.refuse("toolplan.use_previous", "no_previous_plan")
    await bench.accept("toolplan.plan", **POSES[0])
    await bench.accept("toolplan.plan", **POSES[1])
    planned, plan_id = bench.data.plan, bench.data.plan_id
    await bench.accept("toolplan.clear")
    assert bench.data.plan is None
    await bench.accept("toolplan.use_previous")
    assert bench.states["toolplan"] == "1"
    assert bench.data.plan == planned
    assert bench.data.plan_id not in (None, plan_id), "what was approached by the other id is not at this plan"


async def test_nothing_of_another_patient_is_taken_back() -> None:
    """Nor anything of another calibration or reference."""
    async with open_bench() as bench:
        await bench.register()
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        before = bench.cell.settings
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
            for name in ("registration.use_previous", "digitization.reuse_previous", "toolplan.use_previous"):
                await bench.refuse(name, code)
            bench.cell.settings = before
        for name in ("digitization.reuse_previous", "registration.use_previous", "toolplan.use_previous"):
            await bench.accept(name)


async def test_a_plan_that_could_not_be_made_now_is_not_taken_back(bench: WorkflowBench) -> None:
    """The registration that is in force now is too inaccurate at the plan of the one before."""
    await bench.accept("toolplan.plan", position=[0.0, 0.6, 0.5], quat_xyzw=POSES[0]["quat_xyzw"])
    await bench.accept("toolplan.clear")
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")
    await bench.refuse("toolplan.use_previous", "tre_too_large")
