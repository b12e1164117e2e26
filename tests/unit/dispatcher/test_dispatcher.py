"""The semantics that PCMRS pins down, one line after the other, at the surface of the dispatcher.

And what follows from a verdict: publication, locks and posted commands.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Run
from pcmrs.errors import ReentrancyError, RefusalError
from pcmrs.fsm import Blueprint, close
from pcmrs.fsm.closure import MAX_EFFECTS, Denial
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RATMS, RETRACTED, STANDOFF, Bench, Notes, code


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


async def test_03_a_failed_motion_commits_its_place_and_no_data(bench: Bench) -> None:
    await bench.go(RETRACTED)

    async def fail(run: Run[Any, Notes]) -> None:
        run.keep(plan_id="must not be kept")
        raise RefusalError("no", "No.")

    bench.script.steps["placement.approach"] = fail
    verdict = await bench.do("placement.approach")
    assert (verdict.decision, bench.joint, bench.data.plan_id) == ("failed", HELD, None)


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


async def test_05_rejection_names_the_step_that_leads_on(bench: Bench) -> None:
    verdict = await bench.do("placement.approach")
    assert verdict.reason is not None
    assert verdict.reason.fields["next"] == "registration.plan_landmarks"
    assert verdict.reason.text.endswith("Next: registration.plan_landmarks.")
    await bench.go(RETRACTED)
    await bench.dispatcher.stop("test:operator")
    latched = await bench.do("placement.approach")
    assert latched.reason is not None
    assert (latched.reason.code, latched.reason.fields["next"]) == ("latched", "robot.acknowledge")


async def test_next_step_follows_the_committed_states(bench: Bench) -> None:
    found = bench.dispatcher.next_step("robot.disconnect")
    assert (found.next, found.path) == ("robot.connect", ["robot.connect", "robot.disconnect"])
    assert (await bench.do("robot.connect")).decision == "accepted"
    assert bench.dispatcher.next_step("robot.disconnect").next == "robot.disconnect"
    await bench.dispatcher.stop("test:operator")
    stop = bench.dispatcher.stop_number
    assert f"Stop {stop} is latched" in bench.dispatcher.next_step().why


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


async def test_13_decision_is_published_only_when_it_is_durable(bench: Bench) -> None:
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    task = await bench.begin("toolplan.plan")
    assert (task.done(), bench.published, bench.joint) == (False, [], INITIAL)
    gate.set()
    assert (await task).state == "1"


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


def posting(name: str) -> Any:
    async def post(run: Run[Any, Notes]) -> None:
        branch, operation = name.split(".")
        run.post(branch, operation)

    return post


async def test_failure_after_a_verdict_is_fail_stop_and_frees_locks(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("The test wants it to fail.")

    await bench.go(STANDOFF)
    monkeypatch.setattr(bench.dispatcher._activities, "follow", fail)
    assert (await bench.do("placement.back_off")).decision == "accepted"
    await settle()
    assert bench.dispatcher.broken is not None
    assert bench.dispatcher.broken.code == "internal_error"
    assert bench.dispatcher._locks.running == []
    assert (bench.holds, bench.dispatcher.snapshot().latched) == (1, True)
    assert code(await bench.do("toolplan.plan")) == "internal_error"


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


@pytest.mark.parametrize("name", ["registration.plan_landmarks", "robot.connect", "registration.no_such_operation"])
async def test_requester_is_answered_before_the_verdict_is_published(bench: Bench, name: str) -> None:
    published_at_reply: list[int] = []

    async def request() -> None:
        await bench.dispatcher.submit(bench.command(name))
        published_at_reply.append(sum(isinstance(each, Verdict) for each in bench.published))

    await asyncio.gather(request())
    await settle()
    assert published_at_reply == [0]
    assert sum(isinstance(each, Verdict) for each in bench.published) == 1
