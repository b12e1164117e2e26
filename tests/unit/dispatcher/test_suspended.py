"""A dispatcher that is suspended takes no command but retreats; Stop, events and what runs go on."""

from __future__ import annotations

import asyncio

from pcmrs.messages import DeviceEvent, Reason
from tests.unit.dispatcher.dispatcher_fakes import RETRACTED, STANDOFF, Bench

FULL = Reason(code="disk_full", text="50 MB are free.")


async def test_commands_are_rejected_without_a_row_and_later_redecided(bench: Bench) -> None:
    await bench.go(RETRACTED)
    rows = len(bench.recorder.rows)
    bench.dispatcher.suspend(FULL)

    for name in ("toolplan.clear", "placement.approach", "robot.disconnect"):
        verdict = await bench.do(name, id=f"again-{name}")
        assert (verdict.decision, verdict.reason) == ("rejected", FULL)
        assert verdict in bench.published
    assert len(bench.recorder.rows) == rows

    bench.dispatcher.suspend(None)
    verdict = await bench.do("placement.approach", id="again-placement.approach")
    assert verdict.decision == "accepted"
    assert bench.joint == STANDOFF


async def test_stop_events_and_running_commands_continue(bench: Bench) -> None:
    await bench.go(RETRACTED)
    rows = len(bench.recorder.rows)
    bench.dispatcher.suspend(FULL)

    await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="gone", danger=True))
    assert bench.dispatcher.snapshot().branches["robot"] == "0"
    await bench.dispatcher.stop("test:operator")

    assert bench.dispatcher.snapshot().latched
    assert len(bench.recorder.rows) > rows
    assert bench.dispatcher.broken is None


async def test_nobody_is_kept_from_retreating(bench: Bench) -> None:
    await bench.go(STANDOFF)
    await bench.dispatcher.stop("test:operator")
    bench.dispatcher.suspend(FULL)

    assert (await bench.do("robot.acknowledge", arguments={"stop": 1})).decision == "accepted"
    assert (await bench.dispatcher.dry_run(bench.command("placement.back_off"))).reason is None
    assert (await bench.do("placement.back_off")).decision == "accepted"
    assert (await bench.do("placement.home")).decision == "accepted"
    assert bench.joint == RETRACTED
    assert (await bench.do("placement.approach")).reason == FULL


async def test_an_operation_that_runs_ends_as_it_would(bench: Bench) -> None:
    await bench.go(RETRACTED)
    approach = asyncio.ensure_future(bench.do("placement.approach"))
    await asyncio.sleep(0)
    bench.dispatcher.suspend(FULL)

    assert (await approach).decision == "accepted"
    assert bench.joint == STANDOFF
