"""What fails inside the dispatcher itself is fail-stop: nobody waits for ever, no lock stays, no event is lost."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.fsm import Closure, Denial
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import RETRACTED, STANDOFF, Bench

LOST = DeviceEvent(device="robot", code="link_lost", text="The link is lost.", danger=True)


def code(verdict: Verdict) -> str:
    return verdict.reason.code if verdict.reason is not None else verdict.decision


def break_asking(bench: Bench, monkeypatch: pytest.MonkeyPatch, operation: str) -> None:
    """From now on an error of the program shows whenever the states are asked about an operation."""
    ask = bench.dispatcher.procedure.ask

    def broken(branch: str, asked: str) -> Closure | Denial:
        if asked == operation:
            raise RuntimeError("The test wants it to fail.")
        return ask(branch, asked)

    monkeypatch.setattr(bench.dispatcher.procedure, "ask", broken)


def expect_fail_stop(bench: Bench) -> None:
    dispatcher = bench.dispatcher
    assert dispatcher.broken is not None
    assert dispatcher.broken.code == "internal_error"
    assert (dispatcher._locks.running, dispatcher._locks.waiting) == ([], [])
    assert dispatcher.snapshot().latched
    assert bench.holds > 0


async def test_a_command_that_cannot_be_admitted(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    await bench.go(RETRACTED)
    break_asking(bench, monkeypatch, "approach")
    assert code(await bench.do("placement.approach")) == "internal_error"
    await settle()
    expect_fail_stop(bench)


async def test_an_event_that_cannot_be_admitted_ends_no_stop(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    await bench.go(RETRACTED)
    break_asking(bench, monkeypatch, "link_lost")
    await bench.dispatcher.report(LOST)
    await settle()
    expect_fail_stop(bench)


async def test_commands_behind_one_that_cannot_be_redecided(
    worldly_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = worldly_bench
    await bench.go(RETRACTED)
    end = bench.script.hang("toolplan.plan")
    first = await bench.begin("toolplan.plan")
    second = await bench.begin("toolplan.clear")
    third = await bench.begin("toolplan.plan")
    break_asking(bench, monkeypatch, "clear")
    end.set()
    await settle()
    assert (first.done(), second.done(), third.done()) == (True, True, True)
    assert (code(await second), code(await third)) == ("internal_error", "internal_error")
    expect_fail_stop(bench)


async def test_commands_rejected_by_stop_that_cannot_be_recorded(
    worldly_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = worldly_bench
    await bench.go(RETRACTED)
    bench.script.hang("toolplan.plan")
    running = await bench.begin("toolplan.plan")
    waiting = await bench.begin("toolplan.clear")

    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("The test wants it to fail.")

    monkeypatch.setattr(bench.recorder, "decision", broken)
    stop = asyncio.create_task(bench.dispatcher.stop("test:user"))
    await settle()
    assert (running.done(), waiting.done(), stop.done()) == (True, True, True)
    assert await stop
    assert (code(await running), code(await waiting)) == ("internal_error", "internal_error")
    expect_fail_stop(bench)


@pytest.mark.parametrize("name", ["placement.approach", "toolplan.plan"])
async def test_one_that_has_ended_and_cannot_be_concluded(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    await bench.go(RETRACTED)

    def broken(*_: object) -> None:
        raise RuntimeError("The test wants it to fail.")

    monkeypatch.setattr(bench.dispatcher._performer, "_still_so", broken)
    verdict = await bench.do(name)
    assert (verdict.decision, code(verdict)) == ("unknown", "internal_error")
    await settle()
    expect_fail_stop(bench)


async def test_a_danger_that_cannot_be_taken(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The task of a report dies, and with it what it was to stop."""

    def broken(_: DeviceEvent) -> None:
        raise RuntimeError("The test wants it to fail.")

    await bench.go(STANDOFF)
    monkeypatch.setattr(bench.dispatcher.lease, "follow", broken)
    bench.dispatcher.report_later(LOST)
    await settle()
    expect_fail_stop(bench)


async def test_stop_after_a_failure_is_confirmed_if_the_robot_stands(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    await bench.go(RETRACTED)
    break_asking(bench, monkeypatch, "approach")
    await bench.do("placement.approach")
    await settle()
    assert bench.dispatcher.snapshot().stop.confirmed


async def test_stop_after_a_failure_is_unconfirmed_by_a_silent_robot(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    await bench.go(RETRACTED)
    bench.hold_error = RuntimeError("silent")
    break_asking(bench, monkeypatch, "approach")
    await bench.do("placement.approach")
    await settle()
    assert (bench.dispatcher.snapshot().stop.confirmed, bench.dispatcher.in_doubt) == (False, True)
