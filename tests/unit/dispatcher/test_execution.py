"""Checks and steps: what refuses, raises or is late; checks that a planner asks while the loop goes on; and holds."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import suppress
from typing import Any

import msgspec
import pytest

from pcmrs.background import BackgroundTasks
from pcmrs.dispatcher import Run
from pcmrs.dispatcher.execution import MOST_PLANS, Hold
from pcmrs.errors import DeviceError, RefusalError
from pcmrs.messages import LeaseState, Reason, Verdict
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import HELD, RATMS, RETRACTED, STANDOFF, Bench, Notes, code


class GatedPlanner:
    """Answers when the test opens its gate.

    Attributes:
        asked: States by which checks were asked, in order.
        limits: Limits of the wait for the answers, in order.
        meanwhile: Is done while a check is asked.
        refused: The answer.
    """

    def __init__(self) -> None:
        self.gate = asyncio.Event()
        self.gate.set()
        self.asked: list[dict[str, str]] = []
        self.limits: list[float | None] = []
        self.meanwhile: Callable[[], None] = lambda: None
        self.refused: Reason | None = None

    async def check(self, run: Run[Any, Notes], checks: Sequence[str], within: float | None = None) -> Reason | None:
        self.asked.append(dict(run.states))
        self.limits.append(within)
        await self.gate.wait()
        self.meanwhile()
        return self.refused


@pytest.fixture
def planner() -> GatedPlanner:
    return GatedPlanner()


@pytest.fixture
async def planned(planner: GatedPlanner) -> AsyncIterator[Bench]:
    made = Bench(planner=planner, lasting=("approach_possible", "plan_reachable"))
    yield made
    planner.gate.set()
    await made.dispatcher.close()


def told(verdict: Verdict) -> tuple[str, str]:
    assert verdict.reason is not None
    return verdict.decision, verdict.reason.code


async def test_loop_continues_while_a_motion_is_planned(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)
    planner.gate.clear()
    approach = await planned.begin("placement.approach")
    assert told(await planned.do("placement.home")) == ("rejected", "busy")
    assert planned.dispatcher.snapshot().running == []  # nothing has begun
    planner.gate.set()
    assert (await approach).decision == "accepted"
    assert planned.joint == STANDOFF


async def test_a_refusal_of_the_planner_rejects_and_nothing_begins(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)
    planned.script.entered.clear()
    planner.refused = Reason(code="planner_lost", text="It has ended.")
    assert told(await planned.do("placement.approach")) == ("rejected", "planner_lost")
    assert (planned.script.entered, planned.joint) == ([], RETRACTED)


async def test_stop_ends_the_planning_and_does_not_wait_for_it(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)
    planned.script.entered.clear()
    planner.gate.clear()
    approach = await planned.begin("placement.approach")
    await planned.dispatcher.stop("test:operator")
    assert told(await approach) == ("rejected", "stopped")
    await planned.do("robot.acknowledge", source="local:test")
    planner.gate.set()
    await settle()
    assert "placement.approach" not in planned.script.entered


async def test_motion_latched_while_it_is_planned_does_not_start(planned: Bench, planner: GatedPlanner) -> None:
    """The latch is asked again, whoever has set it."""
    await planned.go(RETRACTED)
    planned.script.entered.clear()
    planner.meanwhile = planned.dispatcher.procedure.latch
    assert told(await planned.do("placement.approach")) == ("rejected", "latched")
    assert planned.script.entered == []


async def test_a_motion_is_planned_again_where_the_plan_has_changed(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)
    planner.asked.clear()
    procedure = planned.dispatcher.procedure

    def change_once() -> None:
        if len(planner.asked) == 1:
            procedure.data = msgspec.structs.replace(procedure.data, plan_id="another")

    planner.meanwhile = change_once
    assert (await planned.do("placement.approach")).decision == "accepted"
    assert len(planner.asked) == 2


async def test_a_motion_whose_plan_never_stands_still_is_rejected(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)
    planner.asked.clear()
    procedure = planned.dispatcher.procedure

    def change() -> None:
        procedure.data = msgspec.structs.replace(procedure.data, plan_id=f"plan {len(planner.asked)}")

    planner.meanwhile = change
    assert told(await planned.do("placement.approach")) == ("rejected", "changed_while_planning")
    assert len(planner.asked) == MOST_PLANS


async def test_a_planner_that_raises_rejects_and_the_daemon_works_on(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)

    def fail() -> None:
        raise OSError("broken pipe")

    planner.meanwhile = fail
    assert told(await planned.do("placement.approach")) == ("rejected", "check_raised")
    planner.meanwhile = lambda: None
    assert (await planned.do("placement.approach")).decision == "accepted"


async def test_a_plan_is_put_in_force_when_it_has_been_checked(planned: Bench, planner: GatedPlanner) -> None:
    planner.gate.clear()
    plan = await planned.begin("toolplan.plan", arguments={"values": [1.0]})
    assert planned.joint[2] == "0"
    planner.gate.set()
    assert (await plan).decision == "accepted"
    assert planned.joint[2] == "1"
    assert planned.recorder.with_intent[(await plan).id]  # one row for both: it touches nothing outside


async def test_dry_run_asks_the_planner(planned: Bench, planner: GatedPlanner) -> None:
    await planned.go(RETRACTED)
    planner.refused = Reason(code="unreachable", text="Too far.")
    before = len(planned.recorder.rows)
    dry_run = await planned.dispatcher.dry_run(planned.command("placement.approach"))
    assert dry_run.reason == planner.refused
    assert (len(planned.recorder.rows), planned.joint) == (before, RETRACTED)
    planner.refused = None
    planner.meanwhile = planned.dispatcher.procedure.latch
    dry_run = await planned.dispatcher.dry_run(planned.command("placement.approach"))
    assert dry_run.reason is not None
    assert dry_run.reason.code == "latched"


@pytest.mark.parametrize("refuses", [True, False])
async def test_step_that_replans_its_motion_fails_if_that_is_refused(
    planned: Bench, planner: GatedPlanner, refuses: bool
) -> None:
    moved: list[str] = []

    async def plan_again_and_move(run: Run[Any, Notes]) -> None:
        if refuses:
            planner.refused = Reason(code="unreachable", text="Too far by now.", fields={"distance": 0.9})
        await run.replan()
        moved.append(run.command.operation)

    await planned.go(RETRACTED)
    planner.asked.clear()
    planned.script.steps["placement.approach"] = plan_again_and_move
    verdict = await planned.do("placement.approach")
    assert len(planner.asked) > 1, "again by the step"
    if refuses:
        assert told(verdict) == ("failed", "unreachable")
        assert verdict.reason is not None
        assert (verdict.reason.text, verdict.reason.fields["distance"]) == ("Too far by now.", 0.9)
        assert (moved, planned.joint) == ([], HELD)
    else:
        assert (verdict.decision, set(moved), planned.joint) == ("accepted", {"approach"}, STANDOFF)


def next_motion_possible(run: Run[Any, Notes]) -> None:
    """Plans the second motion of an operation."""
    run.prepared = f"a line from {run.prepared}"


class SecondMotion:
    """An approach whose step plans a second motion while the arm stands after the first one.

    Attributes:
        planning: Is set when the plan of the second motion has been requested.
        moved: Prepared plans by which the arm has moved the second time.
    """

    def __init__(self, bench: Bench, planner: GatedPlanner) -> None:
        self.moved: list[Any] = []
        self._bench, self._planner = bench, planner
        bench.dispatcher._performer._registry.long_check(next_motion_possible)
        bench.script.steps["placement.approach"] = self._step

    async def _step(self, run: Run[Any, Notes]) -> None:
        if self._bench.script.entered.count("placement.approach") > 1:
            return  # the other steps of the operation
        self._planner.asked.clear()
        run.prepared = "here"
        await run.plan(next_motion_possible, within=2.0)
        self.moved.append(run.prepared)


@pytest.fixture
async def second(planned: Bench, planner: GatedPlanner) -> SecondMotion:
    await planned.go(RETRACTED)
    planned.script.entered.clear()
    return SecondMotion(planned, planner)


async def test_step_that_plans_its_next_motion_asks_the_planner(
    planned: Bench, planner: GatedPlanner, second: SecondMotion
) -> None:
    assert (await planned.do("placement.approach")).decision == "accepted"
    assert (len(planner.asked), planner.limits[-1]) == (1, 2.0)
    assert second.moved == ["here"], "what the planner has prepared is the run's"


@pytest.mark.parametrize("reason", ["planner_late", "planner_lost", "unreachable"])
async def test_next_motion_that_is_not_planned_holds_the_arm(
    planned: Bench, planner: GatedPlanner, second: SecondMotion, reason: str
) -> None:
    def refuse() -> None:
        planner.refused = Reason(code=reason, text="No.") if planner.limits[-1] is not None else None

    planner.meanwhile = refuse
    holds = planned.holds
    assert told(await planned.do("placement.approach")) == ("failed", reason)
    assert (second.moved, planned.joint, planned.holds) == ([], HELD, holds + 1)


async def test_a_planner_that_raises_holds_the_arm(planned: Bench, planner: GatedPlanner, second: SecondMotion) -> None:
    def fail() -> None:
        if planner.limits[-1] is not None:
            raise OSError("broken pipe")

    planner.meanwhile = fail
    assert told(await planned.do("placement.approach")) == ("failed", "check_raised")
    assert (second.moved, planned.joint) == ([], HELD)


async def test_stop_while_the_next_motion_is_planned_holds(
    planned: Bench, planner: GatedPlanner, second: SecondMotion
) -> None:
    approach = await _until_second_is_planned(planned, planner)
    await planned.dispatcher.stop("test:operator")
    assert told(await approach) == ("failed", "stopped")
    planner.gate.set()
    await settle()
    assert (second.moved, planned.joint) == ([], HELD)


def _latch(bench: Bench) -> None:
    bench.dispatcher.procedure.latch()


def _lose_lease(bench: Bench) -> None:
    bench.dispatcher.lease.state = LeaseState(holder="ben")


def _change_plan(bench: Bench) -> None:
    procedure = bench.dispatcher.procedure
    procedure.data = msgspec.structs.replace(procedure.data, plan_id="another")


def _change_registration(bench: Bench) -> None:
    procedure = bench.dispatcher.procedure
    procedure.data = msgspec.structs.replace(procedure.data, registration_id="another")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_latch, "latched"),
        (_lose_lease, "lease_held"),
        (_change_plan, "changed_while_planning"),
        (_change_registration, "changed_while_planning"),
    ],
)
async def test_change_while_the_next_motion_is_planned_holds(
    planned: Bench, planner: GatedPlanner, second: SecondMotion, change: Callable[[Bench], None], reason: str
) -> None:
    """What the admission has asked is asked again, whoever has changed it."""

    def meanwhile() -> None:
        if planner.limits[-1] is not None:
            change(planned)

    planner.meanwhile = meanwhile
    holds = planned.holds
    assert told(await planned.do("placement.approach")) == ("failed", reason)
    assert (second.moved, planned.joint, planned.holds) == ([], HELD, holds + 1)


async def test_next_motion_that_no_state_allows_never_begins(
    planned: Bench, planner: GatedPlanner, second: SecondMotion
) -> None:
    """The locks exclude it, so it is a failure of the program."""

    def lose_plan() -> None:
        if planner.limits[-1] is not None:
            planned.dispatcher.procedure._promised["toolplan"] = "0"

    planner.meanwhile = lose_plan
    holds = planned.holds
    assert (await planned.do("placement.approach")).decision == "unknown"
    assert second.moved == []
    assert planned.holds > holds


async def _until_second_is_planned(bench: Bench, planner: GatedPlanner) -> asyncio.Task[Verdict]:
    """Begins the approach, and returns it while the plan of its second motion is awaited."""
    planner.meanwhile = planner.gate.clear  # once the motion itself is planned
    approach = await bench.begin("placement.approach")
    assert (planner.limits[-1], approach.done()) == (2.0, False)
    return approach


async def test_a_stop_during_a_planned_motion_is_as_ever(planned: Bench) -> None:
    await planned.go(RETRACTED)
    planned.script.hang("placement.approach")
    approach = await planned.begin("placement.approach")
    await planned.dispatcher.stop("test:operator")
    assert told(await approach) == ("failed", "stopped")
    assert planned.joint == HELD


async def test_03_a_refused_check_is_rejected_and_named(bench: Bench) -> None:
    await bench.go(("110", "1", "0", "0", "unknown", "0", "off"))
    bench.script.checks["registration.register"] = RefusalError("residual_too_large", "8.2 mm, limit 4.0.", limit=4.0)
    verdict = await bench.do("registration.register")
    assert (verdict.decision, code(verdict)) == ("rejected", "residual_too_large")
    assert verdict.reason is not None
    assert verdict.reason.fields == {
        "limit": 4.0,
        "check": RATMS.branches["registration"].operations["register"].checks[0],
    }
    assert bench.joint[0] == "110"
    assert bench.snapshots()[-1].running == []


async def test_03_a_motion_that_a_check_refuses_takes_no_step(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    bench.script.checks["placement.approach"] = RefusalError("unreachable", "The target cannot be reached.")
    verdict = await bench.do("placement.approach", id="a1")
    assert (verdict.decision, code(verdict), bench.joint) == ("rejected", "unreachable", RETRACTED)
    assert (bench.script.entered, bench.recorder.kinds("a1")) == ([], ["decision"])


async def test_03_a_check_that_raises_is_rejected(bench: Bench) -> None:
    bench.script.checks["toolplan.plan"] = ZeroDivisionError()
    assert code(await bench.do("toolplan.plan")) == "check_raised"


@pytest.mark.parametrize(
    ("error", "expected_code"),
    [
        (RefusalError("too_far", "No."), "too_far"),
        (DeviceError("The robot says no.", code="estop"), "estop"),
        (ValueError("a bug"), "step_raised"),
        (asyncio.CancelledError(), "step_cancelled"),
    ],
)
async def test_03_a_failed_step_leaves_states_and_data(bench: Bench, error: BaseException, expected_code: str) -> None:
    """Fault 3: a failed operation does not activate its target, an exception leaves an active state."""
    await bench.do("registration.plan_landmarks")
    before, data = bench.joint, bench.data

    async def fail(run: Run[Any, Notes]) -> None:
        run.keep(marks=("must not be kept",))
        raise error

    bench.script.steps["digitization.digitize_all"] = fail
    verdict = await bench.do("digitization.digitize_all")
    assert (verdict.decision, code(verdict)) == ("failed", expected_code)
    assert (bench.joint, bench.data) == (before, data)
    assert verdict.reason is not None
    if expected_code != "step_cancelled":
        assert verdict.reason.fields["step"] == RATMS.branches["digitization"].operations["digitize_all"].steps[0]


async def test_03_a_passed_deadline_is_failed(bench: Bench) -> None:
    bench.script.hang("robot.connect")
    task = await bench.begin("robot.connect")
    limit = RATMS.branches["robot"].operations["connect"].timeout_s
    await bench.clock.advance(limit - 0.001)
    assert not task.done()
    await bench.clock.advance(0.001)
    verdict = await task
    assert (verdict.decision, code(verdict), bench.joint) == ("failed", "deadline_passed", INITIAL)


async def test_03_declared_outcomes_have_their_targets_and_others_fail(bench: Bench) -> None:
    await bench.do("registration.plan_landmarks")
    for ending, state in (("partial", "0"), ("nonsense", "0"), ("complete", "1")):
        verdict = await bench.take("digitization", "digitize_one", ending)
        assert verdict.state == state
        assert (verdict.decision == "failed") == (ending == "nonsense")


async def _wait_for(hold: asyncio.Task[bool]) -> bool:
    return await asyncio.shield(hold)


async def test_hold_continues_when_its_caller_is_cancelled() -> None:
    tasks, stands, held = BackgroundTasks(print), asyncio.Event(), asyncio.Event()

    async def hold(_latch: bool) -> None:
        await stands.wait()
        held.set()

    asked = asyncio.create_task(Hold(hold, tasks).end_motion())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    asked.cancel()
    with suppress(asyncio.CancelledError):
        await asked
    stands.set()
    await tasks.wait()

    assert held.is_set()


async def test_cancelled_caller_does_not_end_the_hold_of_others() -> None:
    stands = asyncio.Event()

    async def standing(_latch: bool) -> None:
        await stands.wait()

    hold = Hold(standing, BackgroundTasks(print))
    impatient, patient = (asyncio.create_task(_wait_for(hold.stop())) for _ in range(2))
    await settle()
    impatient.cancel()
    await settle()
    stands.set()
    assert await patient
