"""A workflow loads only with functions that fit its blueprint.

Their arguments, runs and activities, keep their own changes, ask for a new plan, and submit commands with a parent.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from pcmrs.dispatcher import Activity, ProcedureData, Registry, Run, Workflow
from pcmrs.errors import BlueprintError, PcmrsError, RefusalError
from pcmrs.messages import Command, Reason, Verdict
from pcmrs.testing.clock import ManualClock
from tests.unit.dispatcher.dispatcher_fakes import RATMS, Bench, Notes, make_workflow
from tests.unit.dispatcher.following import FOLLOWING

COMMAND = Command(id="c1", branch="placement", operation="approach", source="bus:anna", user="anna", role="operator")


@pytest.fixture
def run() -> Run[Any, ProcedureData]:
    data = ProcedureData(plan_id="old", registration_id="r1")
    return Run(COMMAND, None, {"placement": "held"}, None, ManualClock(), data, lambda fraction: None)


def test_a_run_sees_its_own_changes_and_nobody_else_does(run: Run[Any, ProcedureData]) -> None:
    before = run.data
    run.keep(plan_id="new")
    run.keep(registration_id=None)
    assert run.data == ProcedureData(plan_id="new", registration_id=None)
    assert before == ProcedureData(plan_id="old", registration_id="r1")
    assert run.changes == {"plan_id": "new", "registration_id": None}


async def test_replanning_raises_the_refusal_of_the_checks(run: Run[Any, ProcedureData]) -> None:
    answers = [
        None,
        Reason(code="unreachable", text="0.9 m, limit 0.8 m.", fields={"distance": 0.9, "limit": 0.8}),
    ]

    async def ask() -> Reason | None:
        return answers.pop(0)

    await run.replan()  # without a planner there is nothing to ask
    run.use_planner(ask, lambda check, within: ask())
    await run.replan()
    with pytest.raises(RefusalError, match=r"limit 0\.8 m") as raised:
        await run.replan()
    assert raised.value.refusal_code == "unreachable"
    assert (raised.value.fields["distance"], raised.value.fields["limit"]) == (0.9, 0.8)


async def test_planning_asks_the_named_check_within_its_limit(run: Run[Any, ProcedureData]) -> None:
    asked: list[tuple[str, float]] = []
    answers = [None, Reason(code="planner_late", text="Not within 2 s.", fields={"limit": 2.0})]

    async def plan(check: str, within: float) -> Reason | None:
        asked.append((check, within))
        return answers.pop(0)

    async def replan() -> Reason | None:
        raise AssertionError("the operation's own checks are not asked")

    def line_possible(_: Run[Any, ProcedureData]) -> None: ...

    with pytest.raises(PcmrsError, match="line_possible can only be asked while a dispatcher performs"):
        await run.plan(line_possible, within=2.0)
    run.use_planner(replan, plan)
    await run.plan(line_possible, within=2.0)
    with pytest.raises(RefusalError, match="Not within 2 s") as raised:
        await run.plan(line_possible, within=2.0)
    assert (raised.value.refusal_code, raised.value.fields) == ("planner_late", {"limit": 2.0})
    assert asked == [("line_possible", 2.0)] * 2


async def test_commands_of_an_activity_have_a_parent_and_fresh_ids() -> None:
    submitted: list[Command] = []
    shown: list[None] = []

    def submit(command: Command) -> asyncio.Future[Verdict]:
        submitted.append(command)
        return asyncio.get_running_loop().create_future()

    act: Activity[Any, ProcedureData] = Activity(
        "follow_head",
        "placement",
        "following",
        COMMAND,
        None,
        ManualClock(),
        ProcedureData,
        lambda: {"placement": "following"},
        submit,
        lambda: shown.append(None),
    )
    for _ in range(2):
        act.post("placement", "following_lost", distance=0.1)
    first, second = submitted
    assert (first.parent, first.user, first.role, first.source) == ("c1", "anna", "daemon", "activity:follow_head")
    assert (first.branch, first.operation, first.arguments) == ("placement", "following_lost", {"distance": 0.1})
    assert first.id != second.id, "the second is no repeat of the first"

    act.show(offset_mm=1.0)
    act.show(offset_mm=1.0)
    act.show(angle_deg=2.0)
    assert act.values == {"offset_mm": 1.0, "angle_deg": 2.0}
    assert len(shown) == 2, "only changes are published"


def test_a_name_that_is_not_registered_is_refused() -> None:
    registry: Registry[Any, Notes] = Registry()
    specs = [spec for branch in FOLLOWING.branches.values() for spec in branch.operations.values()]
    registry.checks |= {name: lambda run: None for spec in specs for name in spec.checks}
    registry.steps |= {name: lambda run: None for spec in specs for name in spec.steps}
    with pytest.raises(BlueprintError, match="placement following: no activity is registered as 'follow_head'"):
        Workflow(FOLLOWING, registry, Notes(), lambda data, states, effects: data)
    with pytest.raises(BlueprintError, match="async def"):
        registry.activity(lambda act: None)


@pytest.mark.parametrize("kind", ["step", "activity"])
def test_step_must_be_plain_and_activity_a_coroutine(kind: str) -> None:
    async def waiting(_run: object) -> None: ...

    def at_once(_run: object) -> None: ...

    registry: Registry[Any, Any] = Registry()
    register: Callable[[Any], object] = getattr(registry, kind)
    with pytest.raises(BlueprintError):
        register(waiting if kind == "step" else at_once)


async def test_an_unregistered_name_stops_the_workflow_from_loading(bench: Bench) -> None:
    workflow = make_workflow(bench.script)
    del workflow.registry.checks[RATMS.branches["registration"].operations["register"].checks[0]]
    with pytest.raises(BlueprintError, match=r"registration\.register: no check is registered"):
        type(workflow)(RATMS, workflow.registry, Notes(), workflow.settle)
