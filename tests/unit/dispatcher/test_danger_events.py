"""What a danger event leads to is decided before anybody can acknowledge it, whatever runs or waits."""

from __future__ import annotations

import asyncio

from pcmrs.dispatcher.locks import MAX_WAITING
from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceEvent
from pcmrs.testing.clock import settle
from tests.support.altered import with_operation
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RATMS, STANDOFF, Bench, code

MOVED = DeviceEvent(device="tracker", code="reference_moved", text="By 3 mm.", danger=True)


def pending(bench: Bench) -> list[str]:
    return bench.dispatcher.snapshot().stop.pending


async def test_a_moved_reference_counts_before_the_arm_stands(bench: Bench) -> None:
    """While the hold is slow, an acknowledgement and a motion towards the body come too late."""
    await bench.go(STANDOFF)
    stands = asyncio.Event()
    bench.hold = stands.wait
    report = asyncio.create_task(bench.dispatcher.report(MOVED))
    await settle()
    assert (bench.joint[0], bench.joint[4], pending(bench)) == ("100", "held", ["standstill"])
    assert code(await bench.do("robot.acknowledge")) == "stop_pending"
    assert (await bench.do("placement.confirm")).decision == "rejected"
    stands.set()
    await report
    assert bench.joint[:2] == ("100", "0")


async def test_pending_decisions_are_named(bench: Bench) -> None:
    await bench.go(STANDOFF)
    stands = asyncio.Event()
    bench.hold = stands.wait
    bench.script.hang("placement.confirm")
    motion = await bench.begin("placement.confirm")
    report = asyncio.create_task(bench.dispatcher.report(MOVED))
    await settle()
    assert pending(bench) == ["registration.reference_moved", "standstill"]
    stands.set()
    await asyncio.gather(report, motion)
    assert (bench.joint[0], pending(bench)) == ("100", [])


async def test_an_event_that_the_state_does_not_allow_is_decided(bench: Bench) -> None:
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    report = asyncio.create_task(bench.dispatcher.report(MOVED))
    await settle()
    assert pending(bench) == []
    gate.set()
    await report
    assert [verdict.decision for verdict in bench.verdicts()] == ["rejected"]


async def test_an_event_that_is_rejected_leaves_no_row(bench: Bench) -> None:
    """Only what a device has said of it: the rejection changes nothing, whether the states or a check say it."""
    await bench.go(PLACED)
    before = len(bench.recorder.rows)
    outside = await bench.do("alignment.outside", source="activity:watch_alignment")
    assert (outside.decision, code(outside)) == ("rejected", "invalid_in_state")
    bench.script.checks["alignment.within"] = RefusalError("not_watching", "Another activity watches.")
    within = await bench.do("alignment.within", source="activity:watch_alignment")
    assert within.decision == "rejected"
    await bench.dispatcher.report(DeviceEvent(device="stimulator", code="within", text="It is not so."))
    assert [row[:2] for row in bench.recorder.rows[before:]] == [("event", "within")]
    assert len([verdict for verdict in bench.verdicts() if verdict.decision == "rejected"]) == 3, "all were decided"
    by_somebody = await bench.do("alignment.within", source="bus:anna")
    assert (code(by_somebody), bench.recorder.rows[-1][1]) == ("event_operation", by_somebody.id)


async def test_an_event_waits_for_a_retreat_and_is_never_busy(bench: Bench) -> None:
    await bench.go(STANDOFF)
    gate = bench.script.hang("placement.back_off")
    retreat = await bench.begin("placement.back_off")
    moved = await bench.begin("registration.reference_moved", source="detector:reference")
    assert not moved.done()
    gate.set()
    assert [(await task).decision for task in (retreat, moved)] == ["accepted", "accepted"]
    assert (bench.joint[0], bench.joint[4]) == ("100", "held")


async def test_events_go_ahead_of_a_full_queue(worldly_bench: Bench) -> None:
    bench = worldly_bench
    await bench.go(HELD)
    gate = bench.script.hang("digitization.digitize_all")
    tasks = [await bench.begin("digitization.digitize_all")]
    tasks += [await bench.begin("registration.register") for _ in range(MAX_WAITING)]
    assert code(await bench.do("registration.clear_landmarks")) == "queue_full"
    moved = await bench.begin("registration.reference_moved", source="detector:reference")
    assert not moved.done()
    gate.set()
    assert (await moved).decision == "accepted"
    assert {(await task).decision for task in tasks[1:]} == {"rejected"}, "it was asked first"


async def test_newer_report_replaces_the_waiting_one_and_waits_last(bench: Bench) -> None:
    await bench.go(PLACED)
    gate = bench.script.hang("placement.nudge")
    motion = await bench.begin("placement.nudge")
    first, other, last = [
        await bench.begin(f"alignment.{name}", source="detector:tracker") for name in ("within", "outside", "within")
    ]
    assert (code(await first), other.done(), last.done()) == ("replaced", False, False)
    gate.set()
    await motion
    assert [(await task).decision for task in (other, last)] == ["rejected", "accepted"]
    assert [row[1] for row in bench.recorder.rows].count((await first).id) == 0, "nothing has changed by it"


async def test_reports_with_other_arguments_or_devices_wait_separately() -> None:
    bench = Bench(with_operation(RATMS, "alignment", "within", payload="landmark_index"))
    await bench.go(PLACED)
    gate = bench.script.hang("placement.nudge")
    motion = await bench.begin("placement.nudge")
    asked: list[tuple[str, float]] = [("detector:a", 1.0), ("detector:a", 2.0), ("detector:b", 2.0)]
    waiting = [
        await bench.begin("alignment.within", source=source, arguments={"values": [value]}) for source, value in asked
    ]
    assert [task.done() for task in waiting] == [False] * 3
    gate.set()
    await motion
    assert [(await task).decision for task in waiting] == ["accepted", "rejected", "rejected"]
    await bench.dispatcher.close()
