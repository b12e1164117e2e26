"""Stop: in every phase of an operation, with a queue, twice in a row, by danger events; and its latch.

And the numbers of Stops, acknowledgements, and presses that join a pending Stop.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Run
from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.dispatcher.stops import SOURCES, STANDSTILL, YOUNG, Stops
from pcmrs.errors import RefusalError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, Reason
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.testing.clock import settle
from pcmrs.workflows.cell import Cell
from tests.support.altered import with_operation
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RATMS, RETRACTED, STANDOFF, Bench, Notes, code


async def test_stop_in_a_step(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    holds = bench.holds
    await bench.dispatcher.stop("test:operator")
    verdict = await task
    assert (verdict.decision, code(verdict), verdict.state) == ("failed", "stopped", "held")
    assert bench.holds >= holds + 1
    assert (bench.joint, bench.dispatcher.snapshot().latched) == (HELD, True)


async def test_stop_in_a_step_that_moves_nothing_leaves_the_states(bench: Bench) -> None:
    bench.script.hang("robot.connect")
    task = await bench.begin("robot.connect")
    await bench.dispatcher.stop("test:operator")
    assert ((await task).decision, bench.joint) == ("failed", INITIAL)


async def test_stop_while_it_is_committed(bench: Bench) -> None:
    """Too late to stop: the motion has ended where it was told to."""
    await bench.go(RETRACTED)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    task = await bench.begin("placement.approach")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert (bench.holds, bench.dispatcher.snapshot().latched, stop.done()) == (1, True, False)
    gate.set()
    await stop
    assert ((await task).decision, bench.joint) == ("accepted", STANDOFF)
    shown: dict[int, set[str]] = {}
    for snapshot in bench.snapshots():
        shown.setdefault(snapshot.sequence, set()).add(snapshot.branches["placement"])
    assert [len(states) for states in shown.values() if len(states) > 1] == []
    assert list(shown) == sorted(shown)


async def test_stop_rejects_what_waits(bench: Bench) -> None:
    gate = bench.script.hang("digitization.digitize_all")
    await bench.do("registration.plan_landmarks")
    running = await bench.begin("digitization.digitize_all")
    waiting = [await bench.begin(name) for name in ("registration.register", "registration.clear_landmarks")]
    await bench.dispatcher.stop("test:operator")
    for task in waiting:
        verdict = await task
        assert (verdict.decision, code(verdict)) == ("rejected", "stopped")
    assert (await running).decision == "failed"
    assert bench.joint == ("100", "0", "0", "0", "unknown", "0", "off")
    assert not gate.is_set()


async def test_stop_rejects_no_event_that_waits(bench: Bench) -> None:
    """It has happened already, and will not be reported again."""
    await bench.do("robot.connect")
    gate = asyncio.Event()

    async def slow(run: Run[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await gate.wait()

    bench.script.steps["robot.disconnect"] = slow
    disconnect = await bench.begin("robot.disconnect")
    lost = await bench.begin("robot.link_lost", source="device:robot")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    gate.set()
    await stop
    assert [(await task).decision for task in (disconnect, lost)] == ["failed", "accepted"]
    assert bench.joint == INITIAL


async def test_stop_twice_in_a_row(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    await asyncio.gather(bench.dispatcher.stop("test:a"), bench.dispatcher.stop("test:b"))
    verdict = await task
    assert verdict.reason is not None
    assert verdict.reason.fields == {"source": "test:a"}
    assert bench.joint == HELD
    assert [row[0] for row in bench.recorder.rows].count("event") == 2


async def test_stop_is_shown_at_once(bench: Bench) -> None:
    bench.recorder.gates["event"] = asyncio.Event()
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert bench.snapshots()[-1].latched
    assert [m.code for m in bench.published if isinstance(m, DeviceEvent)] == ["stopped"]
    bench.recorder.gates["event"].set()
    await stop


async def test_a_stopped_caller_of_stop_stops_nothing_less(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await asyncio.sleep(0)
    stop.cancel()
    assert ((await task).decision, bench.joint) == ("failed", HELD)


async def test_nothing_moves_until_acknowledged(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    assert code(await bench.do("placement.back_off")) == "latched"
    assert (await bench.do("toolplan.plan")).decision == "accepted", "what moves nothing goes on"
    assert bench.dispatcher.snapshot().latched
    assert (await bench.do("robot.acknowledge")).decision == "accepted"
    assert not bench.dispatcher.snapshot().latched
    assert (await bench.do("placement.back_off")).decision == "accepted"


async def test_latched_operation_is_not_listed_as_allowed(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    refused = await bench.do("placement.back_off")
    assert "back_off" not in refused.allowed
    await bench.do("robot.acknowledge")
    assert "back_off" in (await bench.do("placement.no_such_operation")).allowed


async def test_an_acknowledgement_does_not_answer_a_later_stop(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    acknowledge = await bench.begin("robot.acknowledge")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    gate.set()
    await asyncio.gather(acknowledge, stop)
    assert bench.dispatcher.snapshot().latched
    assert (await bench.do("robot.acknowledge")).decision == "accepted"
    assert not bench.dispatcher.snapshot().latched


async def test_an_acknowledgement_that_is_refused_releases_nothing() -> None:
    bench = Bench(with_operation(RATMS, "robot", "acknowledge", checks=("has_looked",)))
    await bench.go(HELD)
    bench.hold_error = UnknownOutcomeError("The robot is silent.")
    await bench.dispatcher.stop("test:operator")
    bench.script.checks["robot.acknowledge"] = RefusalError("not_looked", "Look at the robot first.")
    assert code(await bench.do("robot.acknowledge")) == "not_looked"
    assert (bench.dispatcher.snapshot().latched, bench.dispatcher.in_doubt) == (True, True)
    bench.script.checks.clear()
    assert (await bench.do("robot.acknowledge")).decision == "accepted"
    assert (bench.dispatcher.snapshot().latched, bench.dispatcher.in_doubt) == (False, False)
    await bench.dispatcher.close()


@pytest.mark.parametrize("event_code", ["hold_not_confirmed", "force_limit"])
async def test_a_danger_event_goes_the_way_of_stop(bench: Bench, event_code: str) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.report(DeviceEvent(device="tracker", code=event_code, text="Danger.", danger=True))
    assert (code(await task), bench.joint) == (event_code, HELD)
    assert bench.dispatcher.snapshot().latched
    assert [row[1] for row in bench.recorder.rows if row[0] == "event"] == [event_code]


async def test_a_moved_reference_stops_and_takes_the_registration_back(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    moved = DeviceEvent(device="tracker", code="reference_moved", text="By 3 mm.", danger=True)
    await bench.dispatcher.report(moved)
    assert code(await task) == "reference_moved"
    assert bench.joint[:2] == ("100", "0")
    assert bench.joint[4] == "held"
    assert bench.dispatcher.snapshot().latched


async def test_a_lost_link_stops_and_disconnects(bench: Bench) -> None:
    await bench.go(PLACED)
    bench.script.hang("placement.nudge")
    task = await bench.begin("placement.nudge")
    await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="Silent.", danger=True))
    assert (await task).decision == "failed"
    assert bench.joint == ("111", "1", "1", "0", "unknown", "0", "off")
    assert bench.dispatcher.snapshot().latched
    assert bench.recorder.commands[-1].source == "device:robot"


async def test_an_event_without_danger_is_journalled_and_stops_nothing(bench: Bench) -> None:
    await bench.do("robot.connect")
    event = DeviceEvent(device="tracker", code="occluded", text="Hidden.")
    await bench.dispatcher.report(event)
    assert event in bench.published
    assert bench.recorder.rows[-1][:2] == ("event", "occluded")
    assert not bench.dispatcher.snapshot().latched


async def test_device_event_starts_no_operation_of_users(bench: Bench) -> None:
    """Whatever its code is: only operations that are declared as events follow from it."""
    await bench.go(STANDOFF)
    bench.script.entered.clear()
    await bench.dispatcher.report(DeviceEvent(device="robot", code="home", text="At home."))
    assert (bench.script.entered, bench.joint) == ([], STANDOFF)


async def test_stop_gives_its_reason(bench: Bench) -> None:
    bench.script.hang("robot.connect")
    task = await bench.begin("robot.connect")
    await bench.dispatcher.stop("gateway", Reason(code="stopped", text="stop_now_xxxxxxx", fields={"peer": "1"}))
    assert (await task).reason == Reason(code="stopped", text="stop_now_xxxxxxx", fields={"peer": "1"})


async def test_closing_stops_what_runs(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.close()
    assert (await task).state == "held"


async def test_unconfirmed_stop_is_in_doubt_until_it_is_acknowledged(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.hold_error = UnknownOutcomeError("The robot is silent.")
    assert not await bench.dispatcher.stop("test:operator")
    assert bench.dispatcher.in_doubt
    events = [message for message in bench.published if isinstance(message, DeviceEvent)]
    assert events[-1].code == "hold_not_confirmed"
    assert bench.recorder.rows[-1][:2] == ("event", "hold_not_confirmed")
    bench.hold_error = None
    assert await bench.dispatcher.stop("test:operator")
    assert (await bench.do("toolplan.plan")).decision == "accepted"
    assert bench.dispatcher.in_doubt, "nobody has looked yet"
    await bench.do("robot.acknowledge")
    assert not bench.dispatcher.in_doubt


async def test_a_stop_while_the_devices_are_released_stays_latched(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    bench.releasing = asyncio.Event()
    acknowledge = await bench.begin("robot.acknowledge")
    stop = bench.dispatcher.begin_stop("test:operator")
    await settle()
    bench.releasing.set()
    assert await stop
    assert code(await acknowledge) == "stopped"
    assert bench.dispatcher.snapshot().latched


PRESSES = 5_000


@pytest.fixture
async def held() -> AsyncIterator[tuple[Bench, GatewayAdapter, asyncio.Event]]:
    """A bench whose holds are answered when the event is set, and the gateway's way to its Stop."""
    bench = Bench()
    await bench.go(HELD)
    answered = asyncio.Event()
    bench.hold = answered.wait
    core = GatewayAdapter(cast(Any, bench.dispatcher), cast(Cell, None), bench.dispatcher.submit)
    yield bench, core, answered
    answered.set()
    await bench.dispatcher.close()


def events(bench: Bench) -> list[DeviceEvent]:
    return [message for message in bench.published if isinstance(message, DeviceEvent)]


async def test_thousands_of_presses_are_one_stop_and_one_counted_row(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    before, rows = bench.dispatcher.stop_number, len(bench.recorder.rows)
    stops = [asyncio.create_task(core.stop("bus:eve")) for _ in range(PRESSES)]
    await settle()
    answered.set()
    assert await asyncio.gather(*stops) == [True] * PRESSES
    await settle()
    assert bench.dispatcher.stop_number == before + 1
    assert [name for _, name, _, _ in bench.recorder.rows[rows:]] == ["stopped", PRESSED_AGAIN]
    counted = events(bench)[-1]
    assert (counted.code, counted.danger) == (PRESSED_AGAIN, False)
    assert counted.fields == {"stop": before + 1, "presses": PRESSES - 1, "by": {"bus:eve": PRESSES - 1}}


async def test_next_press_after_standstill_is_a_separate_stop(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    answered.set()
    before = bench.dispatcher.stop_number
    for _ in range(3):
        assert await core.stop("bus:eve")
    assert bench.dispatcher.stop_number == before + 3


async def test_press_ends_commands_started_since_the_stop(held: tuple[Bench, GatewayAdapter, asyncio.Event]) -> None:
    bench, core, answered = held
    first = asyncio.create_task(core.stop("bus:eve"))
    await settle()
    bench.script.hang("digitization.digitize_all")
    planning = await bench.begin("digitization.digitize_all")
    before = bench.dispatcher.stop_number
    second = asyncio.create_task(core.stop("bus:eve"))
    await settle()
    assert bench.dispatcher.stop_number == before + 1
    answered.set()
    assert code(await planning) == "stopped"
    await asyncio.gather(first, second)


async def test_sources_have_separate_stops_up_to_a_limit(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    before = bench.dispatcher.stop_number
    stops = [asyncio.create_task(core.stop(f"bus:eve{number}")) for number in range(2 * SOURCES)]
    await settle()
    assert bench.dispatcher.stop_number == before + SOURCES
    stops.append(asyncio.create_task(core.stop("udp:planner:127.0.0.1:4000")))
    await settle()
    assert bench.dispatcher.stop_number == before + SOURCES + 1, "those of the bus take no places of others"
    answered.set()
    await asyncio.gather(*stops)
    await settle()
    joined = {f"bus:eve{number}": 1 for number in range(SOURCES, 2 * SOURCES)}
    assert any(each.fields.get("by") == joined for each in events(bench))


async def test_nothing_releases_the_latch_while_presses_are_counted(
    held: tuple[Bench, GatewayAdapter, asyncio.Event],
) -> None:
    bench, core, answered = held
    stops = [asyncio.create_task(core.stop("bus:eve")) for _ in range(2)]
    await settle()
    assert code(await bench.do("robot.acknowledge")) == "stop_pending"
    answered.set()
    await asyncio.gather(*stops)
    assert (await bench.do("robot.acknowledge")).decision == "accepted"


async def test_stops_share_a_hold_that_is_under_way(bench: Bench) -> None:
    await asyncio.gather(*(bench.dispatcher.stop("test:operator") for _ in range(50)))
    assert bench.holds == 1
    assert [row[:2] for row in bench.recorder.rows] == [("event", "stopped")] * 50


async def test_nobody_acknowledges_while_the_hold_is_under_way(bench: Bench) -> None:
    await bench.go(HELD)
    answered = asyncio.Event()
    bench.hold = answered.wait
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert bench.dispatcher.snapshot().stop.pending == ["standstill"]
    refused = await bench.do("robot.acknowledge")
    assert code(refused) == "stop_pending"
    assert refused.reason is not None
    assert "standstill" in refused.reason.text
    answered.set()
    assert await stop
    assert (bench.dispatcher.snapshot().stop.pending, bench.dispatcher.snapshot().stop.confirmed) == ([], True)
    assert (await bench.do("robot.acknowledge")).decision == "accepted"


async def test_the_hold_of_a_motion_is_merged_with_no_other(bench: Bench) -> None:
    """Its request may still be on its way when the hold of the Stop is answered: only a later hold outdates it."""
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    motion = await bench.begin("placement.confirm")
    answered = asyncio.Event()
    bench.hold = answered.wait
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert bench.latching == [True, False]
    answered.set()
    assert await stop
    assert (await motion).state == "held"


async def test_a_stop_has_its_number_before_anything_is_awaited(bench: Bench) -> None:
    await bench.go(HELD)
    before = bench.dispatcher.stop_number
    stops = [bench.dispatcher.begin_stop("test:operator") for _ in range(3)]
    state = bench.dispatcher.snapshot().stop
    assert (state.number, state.confirmed) == (before + 3, False)
    await asyncio.gather(*stops)
    rows = [message.fields["stop"] for message in bench.published if isinstance(message, DeviceEvent)]
    assert rows == [before + 1, before + 2, before + 3]


async def test_stops_of_a_later_run_have_greater_numbers(bench: Bench) -> None:
    bench.dispatcher.restore(latched=True, unknown=[], start=7)
    assert bench.dispatcher.stop_number > 7
    other = Bench()
    other.dispatcher.restore(latched=False, unknown=[], start=8)
    for _ in range(100):
        await bench.dispatcher.stop("test:operator")
    await other.dispatcher.stop("test:operator")
    assert other.dispatcher.stop_number > bench.dispatcher.stop_number
    await other.dispatcher.close()


async def test_acknowledgement_of_an_older_stop_releases_nothing(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    older = bench.dispatcher.stop_number
    await bench.dispatcher.stop("test:operator")
    refused = await bench.do("robot.acknowledge", arguments={"stop": older})
    assert code(refused) == "stop_outdated"
    assert refused.reason is not None
    assert refused.reason.fields == {"stop": older, "newest": older + 1}
    assert bench.dispatcher.snapshot().latched


@pytest.mark.parametrize("name", ["7", 1.5, True, [1]])
async def test_an_acknowledgement_that_names_no_number_is_malformed(bench: Bench, name: Any) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    assert code(await bench.do("robot.acknowledge", arguments={"stop": name})) == "bad_arguments"
    assert bench.dispatcher.snapshot().latched


async def test_unnamed_stop_is_acknowledged_only_on_site_and_not_young(bench: Bench) -> None:
    """Only a user on site acknowledges without naming the Stop, and only one that is not young."""
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    assert code(await bench.do("robot.acknowledge", arguments={}, user="local")) == "stop_not_named"
    await bench.clock.advance(YOUNG + 0.01)
    assert code(await bench.do("robot.acknowledge", arguments={}, user="carla")) == "stop_not_named"
    assert bench.dispatcher.snapshot().latched
    assert (await bench.do("robot.acknowledge", arguments={}, user="local")).decision == "accepted"
    assert not bench.dispatcher.snapshot().latched


async def test_stops_that_wait_for_one_hold_end_with_it() -> None:
    """The second of two quick Stops raised in the loop when the hold ended; found by exploring."""
    loop, errors = asyncio.get_running_loop(), list[dict[str, Any]]()
    loop.set_exception_handler(lambda _, context: errors.append(context))
    stops, hold = Stops(SystemClock()), loop.create_future()
    for _ in range(2):
        stops.begin()
        stops.wait_for(STANDSTILL, hold)
    hold.set_result(True)
    await asyncio.sleep(0)
    assert (errors, stops.state.pending) == ([], [])
