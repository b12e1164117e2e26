"""Timers: begun by entering a state, ended by leaving it; what they post is decided like the report of a device."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from pcmrs.dispatcher.events import EarlierDecision
from pcmrs.fsm import parse_blueprint
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import Bench
from tests.unit.fsm.timed_workflow import TIMED, timed_blueprint


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench(timed_blueprint(), ["tool", "pulse"])
    yield made
    for gate in made.recorder.gates.values():
        gate.set()
    await made.dispatcher.close()


async def go(bench: Bench, *names: str) -> None:
    for name in names:
        assert (await bench.do(name)).decision == "accepted"
    await settle()


def state(bench: Bench, branch: str) -> str:
    return bench.dispatcher.snapshot().branches[branch]


def timer_rows(bench: Bench) -> list[str]:
    return [row[1] for row in bench.recorder.rows if row[1].startswith("timer_")]


async def test_a_tool_that_is_left_alone_is_held(bench: Bench) -> None:
    await go(bench, "tool.place")
    await bench.clock.advance(599.9)
    assert state(bench, "tool") == "placed"
    await bench.clock.advance(0.2)
    assert state(bench, "tool") == "held"
    (posted,) = (each for each in bench.recorder.commands if each.source == "timer:tool.idle")
    assert (posted.operation, posted.parent, posted.role) == ("left_alone", "c1", "daemon")
    assert timer_rows(bench) == ["timer_started", "timer_ended"]
    assert not bench.dispatcher.snapshot().latched


async def test_after_it_has_expired_the_way_back_is_offered(bench: Bench) -> None:
    await go(bench, "tool.place")
    await bench.clock.advance(600)
    assert "withdraw" in (await bench.do("tool.look")).allowed


async def test_leaving_the_state_ends_the_timer(bench: Bench) -> None:
    await go(bench, "tool.place", "tool.withdraw")
    await bench.clock.advance(5000)
    assert state(bench, "tool") == "away"
    assert timer_rows(bench) == ["timer_started", "timer_ended"]


async def test_who_acts_begins_the_time_again(bench: Bench) -> None:
    await go(bench, "pulse.arm", "tool.place")
    await bench.clock.advance(500)
    await go(bench, "tool.nudge")
    await bench.clock.advance(500)
    await go(bench, "pulse.give")
    await bench.clock.advance(500)
    await go(bench, "tool.look")  # looking is no acting
    assert state(bench, "tool") == "placed"
    await bench.clock.advance(100)
    assert state(bench, "tool") == "held"


async def test_a_pulse_is_refused_until_the_rest_has_passed(bench: Bench) -> None:
    await go(bench, "tool.place", "pulse.arm", "pulse.give")
    refused = await bench.do("pulse.give")
    assert (refused.decision, state(bench, "pulse")) == ("rejected", "resting")
    await bench.clock.advance(5)
    assert state(bench, "pulse") == "ready"
    assert bench.script.entered.count("pulse.give") == 1, "the timer permits the next pulse and gives none"
    await go(bench, "pulse.give")


async def test_one_that_repeats_goes_on_until_it_is_left(bench: Bench) -> None:
    await go(bench, "session.begin")
    await bench.clock.advance(185)
    assert [each.operation for each in bench.recorder.commands].count("reminded") == 3
    await go(bench, "session.end")
    await bench.clock.advance(600)
    assert [each.operation for each in bench.recorder.commands].count("reminded") == 3


async def test_after_a_pause_missed_times_are_not_made_up(bench: Bench) -> None:
    """A daemon that was paused for ten minutes finds its timers due: each posts once."""
    await go(bench, "session.begin", "tool.place")
    bench.clock.stall(630)
    await bench.clock.advance(0)
    assert state(bench, "tool") == "held"
    assert [each.operation for each in bench.recorder.commands].count("reminded") == 1
    await bench.clock.advance(59)
    assert [each.operation for each in bench.recorder.commands].count("reminded") == 1
    await bench.clock.advance(1)
    assert [each.operation for each in bench.recorder.commands].count("reminded") == 2


async def test_a_wall_clock_that_jumps_changes_nothing(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    await go(bench, "tool.place")
    for wall in (0.0, 4e9):
        monkeypatch.setattr(bench.clock, "wall", lambda wall=wall: wall)
        await bench.clock.advance(299)
        assert state(bench, "tool") == "placed"
    await bench.clock.advance(2)
    assert state(bench, "tool") == "held"


async def test_a_new_run_has_no_timers(bench: Bench) -> None:
    """All branches of a restarted daemon are in their starting states, and their whole time begins when they enter."""
    await go(bench, "tool.place")
    await bench.clock.advance(599)
    again = Bench(timed_blueprint(), ["tool", "pulse"])
    await again.clock.advance(5000)
    assert again.recorder.rows == []
    await go(again, "tool.place")
    await again.clock.advance(599)
    assert state(again, "tool") == "placed"
    await again.dispatcher.close()


async def test_stop_does_not_end_a_timer(bench: Bench) -> None:
    await go(bench, "tool.place", "pulse.arm", "pulse.give")
    await bench.dispatcher.stop("test:user")
    await bench.clock.advance(5)
    assert (state(bench, "pulse"), bench.dispatcher.snapshot().latched) == ("ready", True)
    await bench.clock.advance(600)
    assert state(bench, "tool") == "held"


async def test_an_event_that_waits_does_not_hit_who_acts(bench: Bench) -> None:
    """It waits for the nudge, which begins the time again: the tool was not left alone."""
    await go(bench, "tool.place")
    gate = bench.script.hang("tool.nudge")
    nudged = await bench.begin("tool.nudge")
    await bench.clock.advance(600)
    assert bench.dispatcher.waiting == 1
    gate.set()
    assert (await nudged).decision == "accepted"
    await settle()
    assert (state(bench, "tool"), bench.dispatcher.waiting) == ("placed", 0)
    await bench.clock.advance(599)
    assert state(bench, "tool") == "placed"
    await bench.clock.advance(1)
    assert state(bench, "tool") == "held"


async def test_an_event_waits_for_an_operation_that_is_no_act(bench: Bench) -> None:
    await go(bench, "tool.place")
    gate = bench.script.hang("tool.look")
    looking = await bench.begin("tool.look")
    await bench.clock.advance(600)
    assert (state(bench, "tool"), bench.dispatcher.waiting) == ("placed", 1)
    gate.set()
    await looking
    await settle()
    assert state(bench, "tool") == "held"


async def test_an_event_of_an_earlier_stay_never_counts(bench: Bench) -> None:
    """The state is left and entered again while the event waits for its branch."""
    await go(bench, "tool.place")
    gate = bench.script.hang("tool.look")
    looking = await bench.begin("tool.look")
    away, back = await bench.begin("tool.withdraw"), await bench.begin("tool.place")
    await bench.clock.advance(4)
    gate.set()
    await asyncio.wait([looking, away, back])
    await settle()
    assert state(bench, "tool") == "placed"
    await bench.clock.advance(599)
    assert state(bench, "tool") == "placed"


async def test_a_timer_that_expires_while_nothing_is_written_counts(bench: Bench) -> None:
    """The journal fails, the time passes, and the journal can be written again."""
    await go(bench, "tool.place")
    bench.recorder.failing.add("event")
    bench.dispatcher.report_later(DeviceEvent(device="disk", code="full", text="The disk is full."))
    await settle()
    assert bench.dispatcher.broken is not None
    await bench.clock.advance(600)
    assert state(bench, "tool") == "placed"
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(set())
    await settle()
    assert state(bench, "tool") == "held"


async def nudge_that_the_journal_has(bench: Bench, *reporting: str) -> None:
    """A nudge ends as the journal fails, 600 s after the tool was placed; its row has reached the disk after all.

    Devices report meanwhile that the tool was left alone.
    """
    await go(bench, "tool.place")
    gate = bench.script.hang("tool.nudge")
    nudged = await bench.begin("tool.nudge", id="n1")
    for source in reporting:
        await bench.begin("tool.left_alone", source=source)
    await bench.clock.advance(600)
    assert bench.dispatcher.waiting == 1 + len(reporting)
    bench.recorder.failing.add("decision")
    gate.set()
    assert (await nudged).decision == "unknown"
    await settle()
    assert (bench.dispatcher.broken is not None, bench.dispatcher.waiting) == (True, 0)
    bench.recorder.failing.clear()
    durable = Verdict(id="n1", branch="tool", operation="nudge", decision="accepted", state="placed", sequence=99)
    bench.recorder.earlier["test:user", "n1"] = EarlierDecision(durable, {})


async def test_who_acted_as_the_journal_failed_is_not_hit(bench: Bench) -> None:
    """The event was due and could not be decided; the nudge that it waited for began the time again."""
    await nudge_that_the_journal_has(bench)
    await bench.dispatcher.resume({("test:user", "n1")})
    await settle()
    assert state(bench, "tool") == "placed"
    await bench.clock.advance(599)
    assert state(bench, "tool") == "placed"
    await bench.clock.advance(1)
    assert state(bench, "tool") == "held"


async def test_a_report_counts_although_the_timer_does_not(bench: Bench) -> None:
    """A device has reported the event before the timer has posted it, and neither could be decided."""
    await nudge_that_the_journal_has(bench, "device:watch")
    await bench.dispatcher.resume({("test:user", "n1")})
    await settle()
    assert state(bench, "tool") == "held"


async def test_a_resubmitted_event_does_not_hit_who_acts() -> None:
    """What a device has reported during the failure comes first, and begins the time again."""
    text = TIMED.replace('restarted_by = ["tool.nudge"', 'restarted_by = ["tool.touched", "tool.nudge"')
    text += '[branches.tool.operations.touched]\nfrom = ["placed"]\nto = "placed"\nevent = true\nsteps = ["feel"]\n'
    bench = Bench(parse_blueprint(text.encode()), ["tool"])
    await go(bench, "tool.place")
    bench.recorder.failing.add("decision")
    await bench.do("tool.no_such_operation")
    await bench.do("tool.touched", source="device:skin")
    await bench.clock.advance(600)
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(set())
    await settle()
    assert (state(bench, "tool"), bench.script.entered[-1:]) == ("placed", ["tool.touched"])
    await bench.clock.advance(600)
    assert state(bench, "tool") == "held"
    await bench.dispatcher.close()


async def test_nothing_follows_after_the_end(bench: Bench) -> None:
    await go(bench, "tool.place")
    await bench.dispatcher.close()
    rows = len(bench.recorder.rows)
    await bench.clock.advance(5000)
    assert len(bench.recorder.rows) == rows
    assert state(bench, "tool") == "placed"
