"""The semantics that PCMRS pins down, one line after the other; Stop, locks and the journal have files of their own."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Run
from pcmrs.dispatcher.recorder import EarlierDecision
from pcmrs.errors import BlueprintError, DeviceError, ReentrancyError, RefusalError
from pcmrs.fsm import Blueprint, close
from pcmrs.fsm.closure import MAX_EFFECTS, Denial
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RATMS, RETRACTED, STANDOFF, Bench, Notes, make_workflow


def code(verdict: Verdict) -> str:
    assert verdict.reason is not None
    return verdict.reason.code


async def test_01_everything_is_checked_before_the_first_step(bench: Bench) -> None:
    """The parent would refuse the signal at the end, so the pointer is never asked for."""
    verdict = await bench.do("digitization.digitize_all")
    assert (verdict.decision, code(verdict)) == ("rejected", "parent_refuses")
    assert bench.script.entered == []
    assert bench.recorder.kinds(verdict.id) == ["decision"]


async def test_02_branches_commit_together_and_show_old_state_before(bench: Bench) -> None:
    """Observers see the old state until the commit."""
    await bench.do("registration.plan_landmarks")
    gate = bench.script.hang("digitization.digitize_all")
    task = await bench.begin("digitization.digitize_all")
    shown = bench.snapshots()[-1]
    assert (shown.branches["registration"], shown.branches["digitization"]) == ("100", "0")
    assert [(r.branch, r.operation) for r in shown.running] == [("digitization", "digitize_all")]
    gate.set()
    verdict = await task
    for snapshot in bench.snapshots():
        assert (snapshot.branches["registration"][1], snapshot.branches["digitization"]) in (("0", "0"), ("1", "1"))
    assert bench.snapshots()[-1].running == []
    assert bench.snapshots()[-1].sequence == verdict.sequence


async def test_02_each_commit_is_published_once(bench: Bench) -> None:
    await bench.go(PLACED)
    commits = [snapshot.sequence for snapshot in bench.snapshots() if not snapshot.running]
    assert commits == list(range(1, len(commits) + 1))


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


async def test_03_a_failed_motion_commits_its_place_and_no_data(bench: Bench) -> None:
    await bench.go(RETRACTED)

    async def fail(run: Run[Any, Notes]) -> None:
        run.keep(plan_id="must not be kept")
        raise RefusalError("no", "No.")

    bench.script.steps["placement.approach"] = fail
    verdict = await bench.do("placement.approach")
    assert (verdict.decision, bench.joint, bench.data.plan_id) == ("failed", HELD, None)


async def test_03_a_motion_whose_hold_is_not_confirmed_is_unknown(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.hold_error = DeviceError("No answer.")
    verdict = await bench.take("placement", "approach", "failed")
    assert (verdict.decision, verdict.state) == ("unknown", "unknown")


@pytest.mark.parametrize("error", [DeviceError("No answer."), OSError("socket gone"), TimeoutError()])
async def test_04_whatever_hold_raises_it_is_not_confirmed(bench: Bench, error: Exception) -> None:
    await bench.go(STANDOFF)
    bench.hold_error = error
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.stop("test:operator")
    assert ((await task).decision, bench.joint[4]) == ("unknown", "unknown")


async def test_04_an_unknown_outcome_holds_and_only_locate_ends_it(bench: Bench) -> None:
    await bench.go(RETRACTED)
    holds = bench.holds
    command = bench.command("placement.approach")
    bench.script.end("placement.approach", "unknown")
    verdict = await bench.dispatcher.submit(command)
    assert (verdict.decision, code(verdict), bench.joint[4]) == ("unknown", "outcome_unknown", "unknown")
    assert bench.holds == holds + 1
    entered = list(bench.script.entered)
    assert await bench.dispatcher.submit(command) == verdict
    assert bench.script.entered == entered
    assert [name for name in verdict.allowed if name != "reinit"] == ["locate"]
    assert (await bench.take("placement", "locate", "held")).state == "held"


async def test_05_rejection_names_branch_state_reason_and_allowed(bench: Bench) -> None:
    """A rejection is a value. It lists the operations that are allowed in the state."""
    verdict = await bench.do("registration.register")
    assert (verdict.decision, verdict.branch, verdict.state) == ("rejected", "registration", "000")
    assert code(verdict) == "invalid_in_state"
    assert verdict.allowed == ["plan_landmarks", "use_previous", "clear_landmarks", "reinit"]
    assert bench.published[-1] == verdict
    assert bench.recorder.rows[-1] == ("decision", verdict.id, dict(bench.dispatcher.snapshot().branches), verdict)


@pytest.mark.parametrize(
    ("name", "arguments", "expected_code"),
    [
        ("roof.plan", {}, "unknown_branch"),
        ("toolplan.think", {}, "unknown_operation"),
        ("toolplan.plan", {"value": 1}, "bad_arguments"),
        ("toolplan.plan", {"values": "many"}, "bad_arguments"),
        ("toolplan.plan", {"values": ["1.5"]}, "bad_arguments"),
        ("toolplan.plan", {"values": [1.0, float("nan")]}, "bad_arguments"),
        ("toolplan.plan", {"values": [float("-inf")]}, "bad_arguments"),
        ("toolplan.clear", {"values": []}, "bad_arguments"),
    ],
)
async def test_05_malformed_commands_are_rejected(
    bench: Bench, name: str, arguments: dict[str, Any], expected_code: str
) -> None:
    verdict = await bench.do(name, arguments=arguments)
    assert (verdict.decision, code(verdict), bench.joint) == ("rejected", expected_code, INITIAL)


async def test_05_an_old_command_is_rejected(bench: Bench) -> None:
    sent = bench.clock.wall()
    await bench.clock.advance(2.0)
    assert code(await bench.do("toolplan.plan", sent=sent, ttl=1.5)) == "expired"
    assert (await bench.do("toolplan.plan", sent=sent, ttl=2.5)).decision == "accepted"


async def test_08_cancelling_the_caller_does_not_cancel_the_operation(bench: Bench) -> None:
    gate = bench.script.hang("robot.connect")
    command = bench.command("robot.connect")
    caller = asyncio.create_task(bench.dispatcher.submit(command))
    await settle()
    caller.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await caller
    assert bench.joint[3] == "0"
    gate.set()
    verdict = await bench.dispatcher.submit(command)
    assert (verdict.decision, bench.joint[3]) == ("accepted", "1")
    assert bench.script.entered.count("robot.connect") == len(RATMS.branches["robot"].operations["connect"].steps)


async def test_09_operation_that_awaits_its_dispatcher_raises_at_once(bench: Bench) -> None:
    raised: list[ReentrancyError] = []

    async def awaits(run: Run[Any, Notes]) -> None:
        try:
            await bench.do("toolplan.plan")
        except ReentrancyError as error:
            raised.append(error)
            raise

    bench.script.steps["robot.connect"] = awaits
    verdict = await bench.do("robot.connect")
    assert (verdict.decision, code(verdict), len(raised)) == ("failed", "reentrant", 1)
    assert bench.joint == INITIAL


async def test_09_a_step_may_await_another_dispatcher(bench: Bench) -> None:
    other = Bench()

    async def awaits(run: Run[Any, Notes]) -> None:
        await other.do("toolplan.plan")

    bench.script.steps["robot.connect"] = awaits
    assert (await bench.do("robot.connect")).decision == "accepted"
    assert other.joint[2] == "1"
    await other.dispatcher.close()


def posting(name: str) -> Any:
    async def post(run: Run[Any, Notes]) -> None:
        branch, operation = name.split(".")
        run.post(branch, operation)

    return post


async def test_09_a_step_posts_a_command_which_carries_its_parent(bench: Bench) -> None:
    bench.script.steps["robot.connect"] = posting("placement.locate")
    verdict = await bench.do("robot.connect", id="parent")
    await settle()
    posted = bench.recorder.commands[-1]
    assert verdict.decision == "accepted"
    assert (posted.parent, posted.operation) == ("parent", "locate")
    assert bench.joint[4] == "retracted"


async def test_09_an_operation_that_fails_posts_nothing(bench: Bench) -> None:
    async def post_and_fail(run: Run[Any, Notes]) -> None:
        run.post("toolplan", "plan")
        raise RefusalError("no", "No.")

    bench.script.steps["robot.connect"] = post_and_fail
    await bench.do("robot.connect")
    await settle()
    assert bench.joint == INITIAL


async def test_10_a_cascade_is_capped_at_run_time() -> None:
    """Made without the loader, which would have refused it."""
    tables = {"x": ["x"], "y": ["y"]}
    rules = {
        branch: [{"by": [other], "from": tables[a], "to": b} for a, b in (("x", "y"), ("y", "x"))]
        for branch, other in (("a", "b"), ("b", "a"))
    }
    ring = msgspec.convert(
        {
            "id": "ring",
            "version": "1",
            "branches": {
                name: {
                    "level": 1,
                    "states": {"x": "", "y": ""},
                    "revocations": rules[name],
                    "operations": {"flip": {"from": ["x"], "to": "y"}},
                }
                for name in "ab"
            },
        },
        Blueprint,
    )
    denial = close(ring, ring.initial(), "a", "flip")
    assert isinstance(denial, Denial)
    assert denial.code == "cascade_too_long"
    assert str(MAX_EFFECTS) in denial.text
    bench = Bench(ring)
    assert code(await bench.do("a.flip")) == "cascade_too_long"
    await bench.dispatcher.close()


async def test_11_a_signal_that_finds_the_parent_there_is_a_self_loop(bench: Bench) -> None:
    await bench.go(("110", "1", "0", "0", "unknown", "0", "off"))
    assert (await bench.do("digitization.digitize_all")).decision == "accepted"
    assert bench.joint[:2] == ("110", "1")
    assert bench.data.effects == ("operation digitization 1", "signal registration 110")


async def test_12_session_reinitiation_takes_the_child_along(bench: Bench) -> None:
    """Fault 1: after it, and after planning anew, the workflow goes on."""
    await bench.go(("111", "1", "0", "0", "unknown", "0", "off"))
    await bench.do("registration.reinit")
    assert bench.joint[:2] == ("000", "0")
    assert bench.data.effects == ("operation registration 000", "reinit digitization 0")
    for name in ("plan_landmarks", "plan_landmarks"):
        await bench.do(f"registration.{name}")
        await bench.do("digitization.digitize_all")
        assert bench.joint[:2] == ("110", "1")


async def test_fault_02_what_a_registration_rests_on_ends_it(bench: Bench) -> None:
    for before, name, after in (
        (PLACED, "digitization.digitize_all", ("110", "1", "1", "1", "held", "0", "off")),
        (PLACED, "digitization.redigitize_one", ("100", "0", "1", "1", "held", "0", "off")),
        (PLACED, "registration.plan_landmarks", ("100", "0", "1", "1", "held", "0", "off")),
        (STANDOFF, "toolplan.plan", HELD),
        (STANDOFF, "registration.register", HELD),
    ):
        fresh = Bench()
        await fresh.go(before)
        assert (await fresh.do(name)).decision == "accepted"
        assert fresh.joint == after
        assert (await fresh.do("placement.confirm")).decision == "rejected"
        await fresh.dispatcher.close()


async def test_fault_08_connected_is_set_on_success_and_reset_on_loss(bench: Bench) -> None:
    gate = bench.script.hang("robot.connect")
    task = await bench.begin("robot.connect")
    assert not bench.dispatcher.snapshot().flags["robot_connected"]
    gate.set()
    await task
    assert bench.dispatcher.snapshot().flags["robot_connected"]
    await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="Gone.", danger=True))
    assert not bench.dispatcher.snapshot().flags["robot_connected"]


async def test_13_restart_starts_in_the_initial_states(bench: Bench) -> None:
    assert bench.joint == INITIAL
    assert (bench.dispatcher.snapshot().plan, bench.dispatcher.snapshot().registration) == (None, None)


async def test_13_intent_precedes_the_first_step_and_outcome_the_reply(bench: Bench) -> None:
    """Both are in the journal by then."""
    seen: list[str] = []

    async def look(run: Run[Any, Notes]) -> None:
        seen.extend(bench.recorder.kinds(run.command.id))

    bench.script.steps["robot.connect"] = look
    verdict = await bench.do("robot.connect")
    assert set(seen) == {"intent"}
    assert bench.recorder.kinds(verdict.id) == ["intent", "decision"]
    assert not bench.recorder.with_intent[verdict.id]


async def test_13_one_commit_where_no_step_touches_the_world(bench: Bench) -> None:
    verdict = await bench.do("registration.plan_landmarks")
    assert bench.recorder.kinds(verdict.id) == ["decision"]
    assert bench.recorder.with_intent[verdict.id]


async def test_13_decision_is_published_only_when_it_is_durable(bench: Bench) -> None:
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    task = await bench.begin("toolplan.plan")
    assert (task.done(), bench.published, bench.joint) == (False, [], INITIAL)
    gate.set()
    assert (await task).state == "1"


async def test_14_a_repeat_gets_the_recorded_decision_and_runs_nothing(bench: Bench) -> None:
    command = bench.command("toolplan.plan")
    verdict = await bench.dispatcher.submit(command)
    sequence, entered = bench.dispatcher.snapshot().sequence, list(bench.script.entered)
    assert await bench.dispatcher.submit(command) == verdict
    assert (bench.dispatcher.snapshot().sequence, bench.script.entered) == (sequence, entered)
    rejected = bench.command("registration.register")
    first = await bench.dispatcher.submit(rejected)
    await bench.do("registration.plan_landmarks")
    await bench.do("digitization.digitize_all")
    assert await bench.dispatcher.submit(rejected) == first


async def test_14_a_repeat_while_it_runs_attaches_to_it(bench: Bench) -> None:
    gate = bench.script.hang("robot.connect")
    command = bench.command("robot.connect")
    tasks = [asyncio.create_task(bench.dispatcher.submit(command)) for _ in range(3)]
    await settle()
    gate.set()
    first, *others = await asyncio.gather(*tasks)
    assert others == [first, first]
    assert bench.recorder.kinds(command.id) == ["intent", "decision"]


async def test_14_the_key_is_source_and_id(bench: Bench) -> None:
    await bench.do("toolplan.plan", id="1", source="test:a")
    verdict = await bench.do("toolplan.clear", id="1", source="test:b")
    assert (verdict.operation, bench.joint[2]) == ("clear", "0")


async def test_14_verdicts_of_an_earlier_run_are_recalled(bench: Bench) -> None:
    earlier = Verdict(id="9", branch="toolplan", operation="plan", decision="unknown", state="0", sequence=4)
    bench.recorder.earlier["test:user", "9"] = EarlierDecision(earlier, {})
    assert await bench.do("toolplan.plan", id="9") == earlier
    assert bench.joint == INITIAL


@pytest.mark.parametrize(
    ("name", "arguments"), [("toolplan.clear", {}), ("robot.connect", {}), ("toolplan.plan", {"values": [1.0]})]
)
@pytest.mark.parametrize("earlier_run", [True, False])
async def test_14_an_id_stands_for_one_command(
    bench: Bench, name: str, arguments: dict[str, Any], earlier_run: bool
) -> None:
    """Whoever uses it for something else is not told that this was done."""
    if earlier_run:
        done = Verdict(id="9", branch="toolplan", operation="plan", decision="accepted", state="1", sequence=4)
        bench.recorder.earlier["test:user", "9"] = EarlierDecision(done, {"values": [2.0]})
    else:
        await bench.do("toolplan.plan", id="9", arguments={"values": [2.0]})
    rows, joint = len(bench.recorder.rows), bench.joint
    reused = await bench.do(name, id="9", arguments=arguments)
    assert reused.reason is not None
    assert (reused.decision, reused.reason.code) == ("rejected", "id_reused")
    assert (len(bench.recorder.rows), bench.joint) == (rows, joint)
    assert reused in bench.published
    again = await bench.do("toolplan.plan", id="9", arguments={"values": [2.0]})
    assert again.decision == "accepted", "what it stands for is as before"


async def test_15_flags_follow_the_states_and_decide_nothing(bench: Bench) -> None:
    await bench.go(("110", "1", "0", "0", "unknown", "0", "off"))
    assert bench.dispatcher.snapshot().flags["landmarks_digitized"]
    bench.dispatcher.snapshot().flags["landmarks_digitized"] = False
    assert (await bench.do("registration.register")).decision == "accepted"


async def test_15_a_flag_that_does_not_mirror_its_state_is_fail_stop(bench: Bench) -> None:
    bench.dispatcher.procedure._flags["registered"] = True
    verdict = await bench.do("toolplan.plan")
    assert (verdict.decision, bench.joint, bench.holds) == ("unknown", INITIAL, 1)
    assert (await bench.do("toolplan.plan")).decision == "rejected"


async def test_15_two_active_states_are_fail_stop(bench: Bench) -> None:
    bench.dispatcher.procedure._engine._states.objects["robot"]["1"].activate()
    assert (await bench.do("toolplan.plan")).decision == "unknown"
    assert bench.holds == 1
    assert (await bench.do("toolplan.plan")).decision == "rejected"


async def test_event_operations_are_for_devices_detectors_and_timers(bench: Bench) -> None:
    await bench.do("robot.connect")
    for source in ("udp:planner", "bus:local", "devices", "test:device:"):
        assert code(await bench.do("robot.link_lost", source=source)) == "event_operation"
    for source in ("device:robot", "detector:heartbeat", "timer:watchdog"):
        assert (await bench.do("robot.link_lost", source=source)).decision == "accepted"
        await bench.do("robot.connect")


async def test_data_of_parallel_operations_is_merged(worldly_bench: Bench) -> None:
    async def keep_plan(run: Run[Any, Notes]) -> None:
        run.keep(plan_id="p1")

    gate = asyncio.Event()

    async def keep_registration(run: Run[Any, Notes]) -> None:
        await gate.wait()
        run.keep(registration_id="r1")

    worldly_bench.script.steps |= {"toolplan.plan": keep_plan, "registration.use_previous": keep_registration}
    task = await worldly_bench.begin("registration.use_previous")
    await worldly_bench.do("toolplan.plan")
    gate.set()
    await task
    shown = worldly_bench.dispatcher.snapshot()
    assert (shown.plan, shown.registration) == ("p1", "r1")


async def test_progress_is_published(bench: Bench) -> None:
    async def halfway(run: Run[Any, Notes]) -> None:
        run.progress(0.5)

    bench.script.steps["robot.connect"] = halfway
    await bench.do("robot.connect")
    assert 0.5 in [r.progress for snapshot in bench.snapshots() for r in snapshot.running]


async def test_an_unregistered_name_stops_the_workflow_from_loading(bench: Bench) -> None:
    workflow = make_workflow(bench.script)
    del workflow.registry.checks[RATMS.branches["registration"].operations["register"].checks[0]]
    with pytest.raises(BlueprintError, match=r"registration\.register: no check is registered"):
        type(workflow)(RATMS, workflow.registry, Notes(), workflow.settle)
