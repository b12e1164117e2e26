"""Checks and steps on data run again; those that need a device end as journalled."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Registry, Run, Workflow
from pcmrs.errors import DeviceError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import Engine
from pcmrs.journal import JournalRow
from pcmrs.messages import Command, Reason
from pcmrs.replay._recorder import ReplayRecorder
from pcmrs.replay._workflow import ReplayWorkflow
from pcmrs.replay._world import ReplayCell, RowsClock
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.settings import ProcedureSettings
from tests.support.shipped import shipped_blueprint
from tests.unit.replay.rows import outcome, stored

RATMS = shipped_blueprint("ratms")


def replayed(rows: list[JournalRow], *, check: Any = None, step: Any = None) -> ReplayWorkflow:
    """The blueprint of RATMS, with one check and one step for all its names."""

    def nothing(run: Run[Any, Any]) -> None:
        pass

    registry: Registry[Any, Any] = Registry()
    for branch in RATMS.branches.values():
        registry.activities |= dict.fromkeys((each.run for each in branch.activities.values()), nothing)  # type: ignore[arg-type]
        for spec in branch.operations.values():
            registry.checks |= dict.fromkeys(spec.checks, check or nothing)
            registry.steps |= dict.fromkeys(spec.steps, step or nothing)
            if spec.payload != "none":
                registry.payload(spec.payload, msgspec.defstruct("Anything", []))
    registry.side_effecting.update(RATMS.branches["robot"].operations["connect"].steps)
    engine = Engine(RATMS)
    workflow = Workflow(RATMS, registry, PlacementData(), lambda data, *_: data)
    return ReplayWorkflow(workflow, ReplayRecorder(stored(rows)), engine.ask)


def run_of(name: str) -> Run[Any, Any]:
    branch, operation = name.split(".")
    command = Command(id="c1", branch=branch, operation=operation, source="bus:test", arguments={})
    cell = ReplayCell(ProcedureSettings(patient="P-17"), None)
    return Run(command, None, {}, cell, RowsClock(), PlacementData(), lambda _: None)


def by_settings(run: Run[Any, Any]) -> None:
    if run.cell.settings.patient == "P-17":
        raise RefusalError("other_patient", "It is another patient.")


def by_device(run: Run[Any, Any]) -> None:
    run.cell.poses.newest("coil")


def by_clock(run: Run[Any, Any]) -> None:
    run.clock.monotonic()


def broken(run: Run[Any, Any]) -> None:
    raise KeyError("plan")


CHECK = next(iter(RATMS.branches["placement"].operations["approach"].checks))


def test_a_check_of_settings_is_made_again() -> None:
    workflow = replayed([outcome("placement.approach", decision="accepted")], check=by_settings)
    with pytest.raises(RefusalError) as refused:
        workflow.workflow.registry.checks[CHECK](run_of("placement.approach"))
    assert refused.value.refusal_code == "other_patient"
    assert workflow.answered == set()


@pytest.mark.parametrize("check", [by_device, by_clock])
@pytest.mark.parametrize(("name", "refuses"), [(CHECK, True), ("another_check", False)])
def test_a_check_that_measures_refuses_as_journalled(check: Any, name: str, refuses: bool) -> None:
    """Only if it was this check that refused."""
    reason = Reason(code="pose_stale", text="Not seen.", fields={"check": name, "age": 2.0})
    workflow = replayed([outcome("placement.approach", decision="rejected", reason=reason)], check=check)
    again = workflow.workflow.registry.checks[CHECK]
    if refuses:
        with pytest.raises(RefusalError, match="Not seen") as refused:
            again(run_of("placement.approach"))
        assert refused.value.refusal_code == "pose_stale"
        assert refused.value.fields == {"age": 2.0}
    else:
        again(run_of("placement.approach"))
    assert workflow.answered == {("bus:test", "c1")}


def test_a_defect_in_a_check_is_not_hidden() -> None:
    workflow = replayed([outcome("placement.approach")], check=broken)
    with pytest.raises(KeyError):
        workflow.workflow.registry.checks[CHECK](run_of("placement.approach"))


@pytest.mark.parametrize(
    ("decision", "reason", "error"),
    [
        ("accepted", None, None),
        ("failed", Reason(code="device_failed", text="No."), RefusalError),
        ("unknown", Reason(code="outcome_unknown", text="Silent."), UnknownOutcomeError),
    ],
)
async def test_steps_on_devices_wait_and_end_as_journalled(
    decision: Any, reason: Reason | None, error: type[Exception] | None
) -> None:
    rows = [outcome("robot.connect", decision=decision, reason=reason, states={"robot": "1"})]
    workflow = replayed(rows, step=lambda run: pytest.fail("a device was used"))
    step = workflow.workflow.registry.steps[RATMS.branches["robot"].operations["connect"].steps[0]]
    work = step(run_of("robot.connect"))
    assert work is not None
    task = asyncio.ensure_future(work)
    await asyncio.sleep(0)
    (waiting,) = workflow.waiting
    assert (waiting.index, task.done()) == (0, False)
    waiting.end.set()
    if error is None:
        await task
    else:
        with pytest.raises(error, match=reason.text if reason else ""):
            await task
    assert workflow.waiting == []
    assert workflow.answered == {("bus:test", "c1")}


def test_journalled_data_of_another_program_are_refused() -> None:
    name = RATMS.branches["toolplan"].operations["plan"].steps[0]
    for data in ({"colour": 1}, {"plan": "there"}):
        workflow = replayed([outcome("toolplan.plan", data=data)], step=by_device)
        with pytest.raises(RefusalError) as refused:
            workflow.workflow.registry.steps[name](run_of("toolplan.plan"))
        assert refused.value.refusal_code == "data_unreadable"


def test_a_step_on_data_is_taken_again() -> None:
    def keep(run: Run[Any, Any]) -> None:
        run.keep(plan_id="plan-7")

    workflow, run = replayed([outcome("toolplan.plan")], step=keep), run_of("toolplan.plan")
    workflow.workflow.registry.steps[RATMS.branches["toolplan"].operations["plan"].steps[0]](run)
    assert run.data.plan_id == "plan-7"
    assert workflow.answered == set()


def test_a_refusal_by_a_step_is_raised_again() -> None:
    def refuse(run: Run[Any, Any]) -> None:
        raise DeviceError("No.")

    workflow = replayed([outcome("toolplan.plan")], step=refuse)
    with pytest.raises(DeviceError):
        workflow.workflow.registry.steps[RATMS.branches["toolplan"].operations["plan"].steps[0]](
            run_of("toolplan.plan")
        )
