"""What would be said to a command is what is said to it, and asking changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pcmrs.messages import Command, DryRunResult
from pcmrs.messages.identity import Role
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

FAR = POSES[0] | {"position": [0.9, 0.9, 0.9]}
TURNED = POSES[0] | {"quat_xyzw": [0.0, 1.0, 0.0, 0.0]}


async def ask(bench: WorkflowBench, name: str, role: Role = "operator", **arguments: Any) -> DryRunResult:
    branch, operation = name.split(".")
    command = Command(
        id="asked", branch=branch, operation=operation, source="test:user", role=role, arguments=arguments
    )
    before = bench.states, bench.data, len(bench.recorder.rows), len(bench.published)
    found = await bench.dispatcher.dry_run(command)
    assert (bench.states, bench.data, len(bench.recorder.rows), len(bench.published)) == before
    return found


@pytest.mark.parametrize("pose", [*POSES[:3], FAR, TURNED, {"position": [900.0, 0.0, 0.0], "quat_xyzw": [0, 0, 0, 1]}])
async def test_dry_run_equals_the_verdict_of_the_command(pose: dict[str, Any]) -> None:
    async with open_bench() as bench:
        await bench.register()
        asked = await ask(bench, "toolplan.plan", **pose)
        said = await bench.do("toolplan.plan", **pose)
        assert asked.undecided == []
        assert (asked.reason is None) == (said.decision == "accepted")
        if asked.reason is None:
            assert said.result is not None
            assert asked.result["tre"] == pytest.approx(said.result["tre"])
        else:
            assert said.reason is not None
            assert asked.reason.code == said.reason.code


async def test_undecided_checks_are_named() -> None:
    async with open_bench() as bench:
        assert (await ask(bench, "toolplan.plan", **FAR)).undecided == [
            "Whether the arm reaches it is not known before a registration."
        ]
        await bench.register()
        await bench.accept("robot.disconnect")
        (open_,) = (await ask(bench, "toolplan.plan", **FAR)).undecided
        assert "connected" in open_


@pytest.mark.parametrize(
    ("name", "role", "arguments", "code"),
    [
        ("toolplan.plan", "viewer", POSES[0], "role_not_allowed"),
        ("toolplan.plan", "operator", {"position": [0, 0]}, "bad_arguments"),
        ("toolplan.plan", "operator", {"position": [np.nan, 0, 0], "quat_xyzw": [0, 0, 0, 1]}, "bad_arguments"),
        ("toolplan.fly", "operator", {}, "unknown_operation"),
        ("nowhere.plan", "operator", {}, "unknown_branch"),
        ("placement.confirm", "operator", {}, None),
    ],
)
async def test_dry_run_is_refused_before_any_check_as_the_command(
    name: str, role: Role, arguments: dict[str, Any], code: str | None
) -> None:
    async with open_bench() as bench:
        found = await ask(bench, name, role, **arguments)
        assert found.reason is not None
        assert code in (None, found.reason.code)


async def test_nothing_is_looked_at_while_the_arm_moves() -> None:
    async with open_bench() as bench:
        await bench.register()
        async with bench.moving("placement.approach"):
            found = await ask(bench, "toolplan.plan", **POSES[1])
            assert found.reason is not None
            assert found.reason.code == "busy"
        assert bench.states["placement"] == "standoff"


async def test_landmarks_are_judged_as_well() -> None:
    async with open_bench() as bench:
        assert (await ask(bench, "registration.plan_landmarks", landmarks=LANDMARKS)).reason is None
        on_a_line = [{"name": f"l{k}", "position": [0.01 * k, 0.0, 0.0]} for k in range(5)]
        assert (await ask(bench, "registration.plan_landmarks", landmarks=on_a_line)).reason is not None
