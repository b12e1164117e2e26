"""Activities: begun by entering a state, ended by leaving it, given up to motions, and ended by Stop."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.trial.tour import plan_tour
from pcmrs.dispatcher import Activity
from pcmrs.errors import DeviceError, ReentrancyError, UnknownOutcomeError
from pcmrs.messages import ActiveActivity, DeviceEvent, Reason, Verdict
from pcmrs.testing.clock import settle
from pcmrs.testing.rehearsal import rehearse
from tests.support.trials import examples
from tests.unit.dispatcher.dispatcher_fakes import Bench, Notes
from tests.unit.dispatcher.following import FOLLOWING

STAND = ("approach", "follow", "stand")


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench(FOLLOWING, ["placement"])
    yield made
    await made.dispatcher.close()


@pytest.fixture
async def gate(bench: Bench) -> AsyncIterator[asyncio.Event]:
    """What an activity or a step may wait for; set when the test ends, so that nothing is left waiting."""
    made = asyncio.Event()
    yield made
    made.set()


async def go(bench: Bench, *operations: str) -> None:
    for operation in operations:
        assert (await bench.do(f"placement.{operation}")).decision == "accepted"
    await settle()


def state(bench: Bench) -> str:
    return bench.dispatcher.snapshot().branches["placement"]


def going_on(bench: Bench) -> list[str]:
    return [ongoing.name for ongoing in bench.dispatcher.snapshot().activities]


def events(bench: Bench) -> list[str]:
    return [row[1] for row in bench.recorder.rows if row[0] == "event"]


def why(verdict: Verdict) -> str:
    assert verdict.reason is not None
    return verdict.reason.code


async def test_entering_the_state_begins_it_once_that_is_durable(bench: Bench) -> None:
    await go(bench, "approach")
    gate = bench.recorder.gates["event"] = asyncio.Event()
    await go(bench, "follow")
    assert (going_on(bench), bench.script.acting) == (["follow_head"], [])
    gate.set()
    await settle()
    (act,) = bench.script.acting
    assert (act.name, act.branch, act.state, act.command.operation) == (
        "follow_head",
        "placement",
        "following",
        "follow",
    )
    assert bench.snapshots()[-1].activities == [
        ActiveActivity(branch="placement", state="following", name="follow_head")
    ]
    assert events(bench) == ["activity_started"]


async def test_leaving_the_state_ends_it_and_holds_the_robot(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    assert (await bench.do("placement.let_go")).decision == "accepted"
    assert going_on(bench) == []
    await settle()
    assert (bench.script.log[-1], bench.holds, state(bench)) == ("follow_head ends", 1, "held")
    assert events(bench) == ["activity_started", "activity_ended"]
    assert not bench.dispatcher.snapshot().latched


async def test_motionless_activity_is_followed_by_no_hold(bench: Bench) -> None:
    await go(bench, *STAND, "let_go")
    assert (bench.script.log[-1], bench.holds) == ("watch_alignment ends", 0)


async def test_change_of_another_branch_that_takes_the_state_ends_it(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    assert (await bench.do("plan.change")).decision == "accepted"
    await settle()
    assert (state(bench), bench.script.log[-1], bench.holds) == ("held", "follow_head ends", 1)
    assert not bench.dispatcher.snapshot().latched


async def test_an_operation_that_keeps_the_state_keeps_it_running(bench: Bench) -> None:
    await go(bench, "approach", "follow", "adjust", "adjust")
    assert [act.name for act in bench.script.acting] == ["follow_head"]
    assert going_on(bench) == ["follow_head"]


async def test_a_motion_begins_after_it_has_ended(bench: Bench, gate: asyncio.Event) -> None:
    """It takes its time to end; the motion waits for it, and nothing is held in between."""
    await go(bench, "approach")

    async def slow(act: Activity[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await gate.wait()

    bench.script.activities["follow_head"] = slow
    await go(bench, "follow")
    bench.script.log.clear()
    stand = await bench.begin("placement.stand")
    assert (bench.script.log, going_on(bench)) == ([], [])
    gate.set()
    assert (await stand).decision == "accepted"
    await settle()
    assert bench.script.log == ["follow_head ends", "placement.stand", "watch_alignment begins"]
    assert bench.holds == 0


async def test_motion_does_not_interrupt_the_end_of_an_ending_activity(bench: Bench, gate: asyncio.Event) -> None:
    await go(bench, "approach")

    async def slow(act: Activity[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await gate.wait()
            bench.script.log.append("at rest")

    bench.script.activities["follow_head"] = slow
    await go(bench, "follow", "let_go")
    withdraw = await bench.begin("placement.withdraw")
    assert "placement.withdraw" not in bench.script.log
    gate.set()
    assert (await withdraw).decision == "accepted"
    assert bench.script.log[-3:] == ["at rest", "follow_head ends", "placement.withdraw"]


async def test_a_motion_fails_where_it_does_not_give_way_in_time(bench: Bench, gate: asyncio.Event) -> None:
    async def stubborn(act: Activity[Any, Notes]) -> None:
        while not gate.is_set():
            with contextlib.suppress(asyncio.CancelledError):
                await gate.wait()

    bench.script.activities["follow_head"] = stubborn
    await go(bench, "approach", "follow")
    stand = await bench.begin("placement.stand")
    await bench.clock.advance(FOLLOWING.branches["placement"].operations["stand"].timeout_s)
    verdict = await stand
    assert (verdict.decision, why(verdict), state(bench)) == ("failed", "deadline_passed", "stopped")
    assert "placement.stand" not in bench.script.log
    gate.set()


async def test_a_motion_that_is_refused_leaves_it_running(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    bench.script.checks["placement.stand"] = DeviceError("The test wants this motion to be refused.")
    assert (await bench.do("placement.stand")).decision == "rejected"
    await settle()
    assert (going_on(bench), bench.script.log[-1]) == (["follow_head"], "follow_head begins")


async def test_motionless_activity_continues_during_a_motion(bench: Bench) -> None:
    await go(bench, *STAND)
    gate = bench.script.hang("placement.withdraw")
    withdraw = await bench.begin("placement.withdraw")
    assert going_on(bench) == ["watch_alignment"]
    gate.set()
    assert (await withdraw).decision == "accepted"
    await settle()
    assert (going_on(bench), bench.script.log[-1]) == ([], "watch_alignment ends")


@pytest.mark.parametrize("route", [("approach", "follow"), STAND])
@pytest.mark.parametrize(
    ("error", "code"),
    [(None, "activity_ended"), (DeviceError("Lost."), "device_failed"), (ValueError("A bug."), "activity_raised")],
)
async def test_one_that_ends_by_itself_takes_the_lane_of_stop(
    bench: Bench, route: tuple[str, ...], error: Exception | None, code: str
) -> None:
    gate = asyncio.Event()

    async def act_until(act: Activity[Any, Notes]) -> None:
        await gate.wait()
        if error is not None:
            raise error

    bench.script.activities["watch_alignment" if route == STAND else "follow_head"] = act_until
    await go(bench, *route)
    held = bench.holds
    gate.set()
    await settle()
    assert (state(bench), bench.dispatcher.snapshot().latched, going_on(bench)) == ("held", True, [])
    assert bench.holds > held
    stops = [message for message in bench.published if isinstance(message, DeviceEvent) and message.danger]
    assert [event.code for event in stops] == [code]
    assert stops[0].device == bench.script.acting[-1].source
    ending = bench.recorder.commands[-1]
    assert (ending.source, ending.parent) == (stops[0].device, bench.script.acting[-1].command.id)


async def test_stop_ends_what_moves_and_its_state(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    assert await bench.dispatcher.stop("test:operator")
    assert (state(bench), bench.dispatcher.snapshot().latched) == ("held", True)
    assert bench.script.log[-1] == "follow_head ends"
    assert bench.holds >= 2, "at once, and when it has ended"
    assert events(bench) == ["activity_started", "stopped", "activity_ended"]


async def test_stop_leaves_alone_what_moves_nothing(bench: Bench) -> None:
    await go(bench, *STAND)
    assert await bench.dispatcher.stop("test:operator")
    assert (state(bench), going_on(bench)) == ("placed", ["watch_alignment"])


async def test_one_that_fails_because_of_the_hold_needs_no_other_stop(bench: Bench) -> None:
    async def refused(act: Activity[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            raise DeviceError("The robot is held.") from None

    bench.script.activities["follow_head"] = refused
    await go(bench, "approach", "follow")
    await bench.dispatcher.stop("test:operator")
    assert (events(bench).count("stopped"), events(bench).count("device_failed"), state(bench)) == (1, 0, "held")


async def test_failed_end_is_danger_even_if_the_end_was_requested(bench: Bench) -> None:
    async def failing(act: Activity[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            raise DeviceError("The stream did not end.") from None

    bench.script.activities["follow_head"] = failing
    await go(bench, "approach", "follow")
    verdict = await bench.do("placement.stand")
    await settle()
    assert (verdict.decision, why(verdict), state(bench)) == ("failed", "device_failed", "stopped")
    assert bench.dispatcher.snapshot().latched
    assert "placement.stand" not in bench.script.log


async def test_unconfirmed_standstill_after_it_is_danger(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    bench.hold_error = UnknownOutcomeError("The robot is silent.")
    await go(bench, "let_go")
    assert (bench.dispatcher.snapshot().latched, bench.dispatcher.in_doubt, state(bench)) == (True, True, "held")


async def test_stop_is_not_confirmed_where_the_robot_moved_on_with_it(bench: Bench) -> None:
    """The first hold is confirmed; the one after the activity has ended is not."""

    async def hold() -> None:
        bench.holds += 1
        if bench.holds > 1:
            raise UnknownOutcomeError("The robot is silent.")

    bench.hold = hold
    await go(bench, "approach", "follow")
    assert not await bench.dispatcher.stop("test:operator")
    assert (bench.dispatcher.in_doubt, state(bench)) == (True, "held")


async def test_the_latch_keeps_it_from_beginning(bench: Bench) -> None:
    """Stop while the operation that leads there is being committed: too late for that, but not for what follows."""
    await go(bench, "approach")
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    follow = await bench.begin("placement.follow")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    gate.set()
    await stop
    assert (await follow).decision == "accepted"
    await settle()
    assert (bench.script.acting, state(bench), going_on(bench)) == ([], "held", [])
    assert why(await bench.do("placement.follow")) == "latched"


async def test_two_stops_perform_its_end_once(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    stops = [asyncio.create_task(bench.dispatcher.stop(f"test:{name}")) for name in ("operator", "other")]
    assert all(await asyncio.gather(*stops))
    ended = [command.operation for command in bench.recorder.commands if command.source == "activity:follow_head"]
    assert (ended, state(bench)) == (["following_lost"], "held")


async def test_one_that_begins_waits_for_the_one_before_in_its_branch(bench: Bench, gate: asyncio.Event) -> None:
    await go(bench, *STAND)

    async def slow(act: Activity[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await gate.wait()

    await go(bench, "follow")
    bench.script.activities["watch_alignment"] = slow
    await go(bench, "stand", "follow")
    assert bench.script.log[-1] == "placement.follow"
    assert going_on(bench) == ["follow_head"]
    gate.set()
    await settle()
    assert bench.script.log[-2:] == ["watch_alignment ends", "follow_head begins"]


async def test_fail_stop_ends_all(bench: Bench) -> None:
    await go(bench, *STAND)
    bench.recorder.failing.add("decision")
    await bench.do("plan.change_back")
    await bench.do("plan.change")
    await settle()
    assert (bench.script.log[-1], going_on(bench)) == ("watch_alignment ends", [])
    assert state(bench) == "placed", "nothing is accepted any more"


async def test_a_journal_that_cannot_tell_of_it_is_fail_stop(bench: Bench) -> None:
    await go(bench, "approach")
    bench.recorder.failing.add("event")
    await go(bench, "follow")
    assert (bench.script.acting, going_on(bench), bench.holds > 0) == ([], [], True)


@pytest.mark.parametrize("route", [("approach", "follow"), STAND])
async def test_closing_leaves_no_task(route: tuple[str, ...]) -> None:
    bench = Bench(FOLLOWING, ["placement"])
    await go(bench, *route)
    before = bench.script.log[-1]
    await bench.dispatcher.close()
    assert bench.script.log[-1] == before.replace("begins", "ends")
    assert asyncio.all_tasks() == {asyncio.current_task()}


async def test_it_sees_the_procedure_as_it_is_now_and_may_post(bench: Bench) -> None:
    await go(bench, *STAND)
    act = bench.script.acting[-1]
    before = act.data
    act.post("placement", "adjust")
    await settle()
    posted = bench.recorder.commands[-1]
    assert (posted.operation, posted.source, posted.parent) == ("adjust", "activity:watch_alignment", act.command.id)
    await bench.do("plan.change")
    assert act.states["plan"] == "new"
    assert act.data == bench.data
    assert act.data != before


async def test_its_events_work_while_stop_is_latched(bench: Bench) -> None:
    await go(bench, *STAND)
    await bench.dispatcher.stop("test:operator")
    bench.script.acting[-1].post("placement", "alignment_lost")
    await settle()
    assert (state(bench), bench.script.log[-1], bench.dispatcher.snapshot().latched) == (
        "held",
        "watch_alignment ends",
        True,
    )


async def test_values_shown_are_published_when_they_change(bench: Bench) -> None:
    await go(bench, *STAND)
    act, count = bench.script.acting[-1], len(bench.snapshots())
    act.show(error_mm=0.2)
    act.show(error_mm=0.2)
    act.show(blocked=True)
    assert len(bench.snapshots()) == count + 2
    assert bench.snapshots()[-1].activities[0].values == {"error_mm": 0.2, "blocked": True}
    assert bench.snapshots()[-2].activities[0].values == {"error_mm": 0.2}


async def test_it_cannot_await_its_own_dispatcher(bench: Bench) -> None:
    caught: list[type[Exception]] = []

    async def awaiting(act: Activity[Any, Notes]) -> None:
        try:
            await bench.do("placement.adjust")
        except ReentrancyError as error:
            caught.append(type(error))
        await asyncio.Event().wait()

    bench.script.activities["watch_alignment"] = awaiting
    await go(bench, *STAND)
    assert caught == [ReentrancyError]


COMMANDS = [
    *(f"placement.{operation}" for operation in FOLLOWING.branches["placement"].operations),
    "plan.change",
    "plan.change_back",
    "robot.acknowledge",
]


ACTIONS = st.lists(st.sampled_from([*COMMANDS, *COMMANDS, "stop", "end", "raise", "settle", "settle"]), max_size=25)


@examples(150)
@given(ACTIONS)
async def test_only_the_activity_of_the_present_state_ever_runs(actions: list[str]) -> None:
    """And never beside a motion that has begun, nor while Stop is latched where it moves the robot."""
    bench = Bench(FOLLOWING, ["placement"])
    over: list[asyncio.Future[None]] = []
    here: list[str] = []
    moved: list[list[str]] = []

    async def act_until(act: Activity[Any, Notes]) -> None:
        over.append(asyncio.get_running_loop().create_future())
        here.append(act.name)
        try:
            await over[-1]
        finally:
            here.remove(act.name)

    async def move(run: Any) -> None:
        moved.append(list(here))
        await asyncio.sleep(0)

    bench.script.activities |= dict.fromkeys(("follow_head", "watch_alignment"), act_until)
    bench.script.steps |= dict.fromkeys(COMMANDS, move)
    tasks: list[asyncio.Task[Any]] = []
    for action in actions:
        if action == "settle":
            await settle()
        elif action == "stop":
            tasks.append(asyncio.create_task(bench.dispatcher.stop("test:operator")))
        elif action in ("end", "raise"):
            for future in [each for each in over if not each.done()]:
                future.set_result(None) if action == "end" else future.set_exception(DeviceError("Lost."))
        else:
            command = bench.command(action, source="device:test" if action.endswith("_lost") else "test:user")
            tasks.append(asyncio.create_task(bench.dispatcher.submit(command)))
        await asyncio.sleep(0)
    await asyncio.gather(*tasks)
    await settle()
    spec = FOLLOWING.branches["placement"].activities.get(state(bench))
    assert here == going_on(bench) == ([] if spec is None else [spec.run])
    assert not any("follow_head" in running for running in moved)
    assert not (bench.dispatcher.snapshot().latched and "follow_head" in here)
    await bench.dispatcher.close()
    assert here == []


async def test_a_rehearsal_runs_none() -> None:
    """Its steps are scripted, and nothing registers the activities."""
    done = [judged async for judged in rehearse(FOLLOWING, plan_tour(FOLLOWING), outside=False)]
    assert done
    assert [deviation for _, deviation in done if deviation is not None] == []


async def test_stop_has_its_reason_in_the_journal(bench: Bench) -> None:
    await go(bench, "approach", "follow")
    await bench.dispatcher.stop("gateway", Reason(code="stopped", text="Stop."))
    assert [row[1] for row in bench.recorder.rows if row[0] == "event"][1] == "stopped"
