"""Checks that another process answers: the answer is that of the daemon's own checks, and holds for an arm at rest."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.dispatcher import Run
from pcmrs.dispatcher.command_checks import read_payload
from pcmrs.dispatcher.execution import refusal
from pcmrs.errors import PcmrsError
from pcmrs.messages import Command, Reason
from pcmrs.spatial import Transform
from pcmrs.workflows.planning import MAX_JOINT_DRIFT, PlanAnswer, PlanningCell, apply_answer, request_of
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import POSES, WorkflowBench

FAR = POSES[0] | {"position": [0.9, 0.9, 0.9]}
NOTHING_REFUSED = PlanAnswer(None, "a trajectory", {"tre": 0.002}, ["a question"])


def run_of(bench: WorkflowBench, name: str, **arguments: Any) -> Run[Any, Any]:
    branch, operation = name.split(".")
    command = Command(id="asked", branch=branch, operation=operation, source="test:user", arguments=arguments)
    workflow = shipped_workflow("ratms")
    spec = workflow.blueprint.branches[branch].operations[operation]
    payload = read_payload(workflow, command, spec)
    return Run(command, payload, bench.states, bench.cell, bench.clock, bench.data, lambda _: None, spec.motion)


def checks_of(run: Run[Any, Any]) -> Sequence[str]:
    command = run.command
    return shipped_workflow("ratms").blueprint.branches[command.branch].operations[command.operation].checks


def in_the_loop(run: Run[Any, Any]) -> Reason | None:
    return refusal(shipped_workflow("ratms").registry, checks_of(run), run)


def planning_cell(bench: WorkflowBench) -> PlanningCell:
    """Return a cell without devices, which learns of the arm and the body by requests only."""
    cell = bench.cell
    return PlanningCell(shipped_workflow("ratms"), cell.settings, cell.arm, cell.surface, cell.mounting)


async def test_another_cell_answers_as_the_cell_itself(bench: WorkflowBench) -> None:
    await bench.register()
    elsewhere = planning_cell(bench)
    asked: list[tuple[str, dict[str, Any]]] = [
        ("placement.approach", {}),
        ("toolplan.plan", POSES[1]),
        ("toolplan.plan", FAR),
        ("placement.confirm", {}),
    ]
    for name, arguments in asked:
        here, there = run_of(bench, name, **arguments), run_of(bench, name, **arguments)
        answer = elsewhere.answer(pickle.loads(pickle.dumps(request_of(there, checks_of(there)))))
        assert answer.refused == in_the_loop(here)
        assert answer.result == here.result
        if name == "placement.approach":
            np.testing.assert_allclose(answer.prepared.positions, here.prepared.positions, atol=1e-9)


async def test_plans_rest_on_the_calibration_that_the_daemon_has_read(bench: WorkflowBench) -> None:
    """The planning process may start again after the file of a calibration was replaced."""
    await bench.register()
    moved = Transform(np.eye(3), np.array((0.0, 0.0, 0.02)))
    tip = bench.cell.mounting.tool_marker_from_tool_tip
    mounting = replace(bench.cell.mounting, tool_marker_from_tool_tip=tip @ moved)
    cell = bench.cell
    elsewhere = PlanningCell(shipped_workflow("ratms"), cell.settings, cell.arm, cell.surface, mounting)
    assert elsewhere._cell.mounting is mounting
    assert elsewhere._cell.flange_from_tool_tip.translation == pytest.approx(mounting.flange_from_tool_tip.translation)


async def test_an_answer_puts_plan_and_questions_into_the_run(bench: WorkflowBench) -> None:
    await bench.register()
    run = run_of(bench, "placement.approach")
    assert apply_answer(run, request_of(run, checks_of(run)), NOTHING_REFUSED) is None
    assert (run.prepared, run.result, run.undecided) == ("a trajectory", {"tre": 0.002}, ["a question"])


@pytest.mark.parametrize(("share", "accepted"), [(0.9, True), (1.1, False)])
async def test_a_plan_is_of_no_use_once_the_arm_has_left_its_start(
    bench: WorkflowBench, share: float, accepted: bool
) -> None:
    await bench.register()
    run, joints = run_of(bench, "placement.approach"), bench.cell.joints
    request = request_of(run, checks_of(run))
    assert joints is not None
    moved = [joints.positions[0] + share * MAX_JOINT_DRIFT, *joints.positions[1:]]
    bench.cell.joints = msgspec.structs.replace(joints, positions=moved)
    refused = apply_answer(run, request, NOTHING_REFUSED)
    if accepted:
        assert refused is None
    else:
        assert refused is not None
        assert refused.code == "moved_while_planning"
        assert refused.fields["moved"] == pytest.approx(share * MAX_JOINT_DRIFT)
        assert refused.fields["limit"] == MAX_JOINT_DRIFT
        assert run.prepared is None


async def test_a_check_in_another_process_cannot_wait(bench: WorkflowBench) -> None:
    """Time stands still there: a check that waited would do so for ever."""
    clock = planning_cell(bench)._cell.clock
    with pytest.raises(PcmrsError, match=r"waits for 2 s: let a step do so"):
        await clock.sleep(2.0)
    with pytest.raises(PcmrsError, match=r"waits for up to 3 s: let a step do so"):
        clock.timeout(3.0)
