"""Stop: in every phase of an operation, with a queue, twice in a row, by danger events; and its latch."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.dispatcher import Run
from pcmrs.errors import RefusalError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, Reason
from pcmrs.testing.clock import settle
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
