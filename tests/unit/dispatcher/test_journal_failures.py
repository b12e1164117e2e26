"""A journal that fails is fail-stop: the robot is held, nothing is accepted, Stop and status still work."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, Verdict
from pcmrs.testing.clock import settle
from tests.support.ratms_oracle import Joint
from tests.unit.dispatcher.dispatcher_fakes import PLACED, RETRACTED, STANDOFF, Bench


async def check_fail_stop(bench: Bench, joint: Joint) -> None:
    """Nothing is accepted any more, even with a journal that works again; Stop and status do their work."""
    bench.recorder.failing.clear()
    for name in ("toolplan.plan", "placement.home", "robot.acknowledge"):
        verdict = await bench.do(name)
        assert verdict.decision == "rejected"
        assert verdict.reason is not None
        assert verdict.reason.code == "journal_unavailable"
        assert "Restart the daemon" in verdict.reason.text
    holds = bench.holds
    await bench.dispatcher.stop("test:operator")
    assert bench.holds == holds + 1
    shown = bench.dispatcher.snapshot()
    assert (shown.latched, shown.running, bench.joint) == (True, [], joint)


def answered(bench: Bench, verdict: Verdict) -> bool:
    return verdict in bench.published


async def test_a_failing_intent_starts_no_step(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    bench.recorder.failing.add("intent")
    verdict = await bench.do("placement.approach")
    assert (verdict.decision, bench.script.entered, bench.holds) == ("unknown", [], 1)
    assert answered(bench, verdict)
    assert bench.snapshots()[-1].running == []
    await check_fail_stop(bench, RETRACTED)


async def test_a_failing_outcome_commits_nothing(bench: Bench) -> None:
    await bench.go(RETRACTED)
    data = bench.data
    bench.recorder.failing.add("decision")
    verdict = await bench.do("placement.approach")
    assert (verdict.decision, bench.data, bench.holds) == ("unknown", data, 1)
    assert answered(bench, verdict)
    await check_fail_stop(bench, RETRACTED)


async def test_a_rejection_that_cannot_be_written(bench: Bench) -> None:
    bench.recorder.failing.add("decision")
    verdict = await bench.do("registration.register")
    assert (verdict.decision, bench.holds) == ("rejected", 1)
    await settle()
    assert [each.code for each in bench.published if isinstance(each, DeviceEvent)] == ["fail_stop"]
    assert [kind for kind, *_ in bench.recorder.rows if kind == "event"] == []  # its row comes when it is reopened
    assert bench.snapshots()[-1].latched
    await check_fail_stop(bench, ("000", "0", "0", "0", "unknown", "0", "off"))


async def test_a_failing_recall_runs_nothing(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    bench.recorder.failing.add("recall")
    verdict = await bench.do("placement.approach")
    await settle()
    assert (verdict.decision, bench.script.entered, bench.holds) == ("rejected", [], 1)
    assert answered(bench, verdict)
    await check_fail_stop(bench, RETRACTED)


async def test_unconfirmed_standstill_after_a_failure_is_published(bench: Bench) -> None:
    """While that is in doubt the daemon does not beat either, so that the node holds by itself."""
    await bench.go(RETRACTED)
    bench.hold_error = UnknownOutcomeError("The robot is silent.")
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.clear")
    await settle()
    assert bench.dispatcher.in_doubt
    assert "hold_not_confirmed" in [each.code for each in bench.published if isinstance(each, DeviceEvent)]


@pytest.mark.parametrize("danger", [True, False])
async def test_an_event_that_cannot_be_written(bench: Bench, danger: bool) -> None:
    await bench.go(PLACED)
    bench.recorder.failing |= {"event", "decision"}
    await bench.dispatcher.report(DeviceEvent(device="tracker", code="reference_moved", text="Moved.", danger=danger))
    await settle()
    assert bench.holds >= 1
    assert bench.dispatcher.snapshot().latched
    await check_fail_stop(bench, PLACED)


async def test_stop_holds_although_nothing_can_be_written(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    bench.recorder.failing |= {"event", "decision"}
    await bench.dispatcher.stop("test:operator")
    assert bench.holds >= 1
    assert ((await task).decision, bench.joint) == ("unknown", STANDOFF)
    await check_fail_stop(bench, STANDOFF)


async def test_running_commands_are_stopped_and_waiting_ones_rejected(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    bench.recorder.gates["intent"] = asyncio.Event()
    bench.recorder.gates["intent"].set()
    motion = await bench.begin("placement.confirm")
    waiting = await bench.begin("robot.disconnect")
    bench.recorder.failing.add("decision")
    verdict = await bench.do("robot.connect_nothing")
    assert verdict.decision == "rejected"
    assert (await motion).decision == "unknown"
    assert (await waiting).decision == "rejected"
    await settle()
    assert bench.dispatcher.snapshot().running == []
    await check_fail_stop(bench, STANDOFF)


async def test_waiting_command_does_not_start_after_a_failure(worldly_bench: Bench) -> None:
    """Although the state would allow it, and its decision could be written."""
    worldly_bench.script.hang("toolplan.plan")
    running = await worldly_bench.begin("toolplan.plan")
    waiting = await worldly_bench.begin("toolplan.plan")
    worldly_bench.recorder.failing.add("event")
    await worldly_bench.dispatcher.report(DeviceEvent(device="tracker", code="occluded", text="Hidden."))
    assert (await running).decision == "failed"
    verdict = await waiting
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code) == ("rejected", "journal_unavailable")
    assert worldly_bench.script.entered == ["toolplan.plan"]


async def test_a_bug_in_the_data_of_a_commit_is_fail_stop(bench: Bench) -> None:
    async def keep_nonsense(run: object) -> None:
        run.keep(no_such_field=1)  # type: ignore[attr-defined]

    bench.script.steps["toolplan.plan"] = keep_nonsense
    verdict = await bench.do("toolplan.plan")
    await settle()
    assert (verdict.decision, bench.joint[2], bench.holds) == ("unknown", "0", 1)
    assert verdict.reason is not None
    assert verdict.reason.code == "internal_error"
    told = [each for each in bench.published if isinstance(each, DeviceEvent)]
    assert [(each.device, each.code, each.danger, each.fields) for each in told] == [
        ("daemon", "fail_stop", True, {"reason": "internal_error"})
    ]
    assert [name for kind, name, _, _ in bench.recorder.rows if kind == "event"] == ["fail_stop"]
    assert bench.snapshots()[-1].latched


async def test_running_motion_that_has_become_forbidden_is_fail_stop(bench: Bench) -> None:
    """Locks rule it out, so that memory is not to be trusted any more."""
    await bench.go(RETRACTED)
    gate = bench.script.hang("placement.approach")
    motion = await bench.begin("placement.approach")
    bench.dispatcher.procedure._promised["robot"] = "0"
    gate.set()
    async with asyncio.timeout(10.0):
        verdict = await motion
    assert verdict.reason is not None
    assert (verdict.decision, bench.holds) == ("unknown", 1)
    assert "It was allowed when placement.approach began" in verdict.reason.text
    assert bench.dispatcher.snapshot().running == []


async def test_a_bug_stays_a_bug_when_the_journal_fails_after_it(bench: Bench) -> None:
    """A journal that can be written again would not make the memory one to be trusted."""

    async def keep_nonsense(run: object) -> None:
        run.keep(no_such_field=1)  # type: ignore[attr-defined]

    bench.script.steps["toolplan.plan"] = keep_nonsense
    await bench.do("toolplan.plan")
    bench.recorder.failing.add("event")
    await bench.dispatcher.stop("test:operator")
    bench.recorder.failing.clear()
    assert bench.dispatcher.broken is not None
    assert bench.dispatcher.broken.code == "internal_error"
    with pytest.raises(PcmrsError, match="Only a restart"):
        await bench.dispatcher.resume(in_flight=())


async def test_bug_that_shows_after_the_journal_failed_is_not_resumed(
    worldly_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def decision(*_: object, **__: object) -> asyncio.Future[None]:
        raise ValueError("no such table")

    bench = worldly_bench
    bench.script.hang("toolplan.plan")
    running = await bench.begin("toolplan.plan")
    monkeypatch.setattr(bench.recorder, "decision", decision)
    bench.recorder.failing.add("event")
    await bench.dispatcher.report(DeviceEvent(device="tracker", code="occluded", text="Hidden."))
    await running
    bench.recorder.failing.clear()
    assert bench.dispatcher.broken is not None
    assert bench.dispatcher.broken.code == "internal_error"
    with pytest.raises(PcmrsError, match="Only a restart"):
        await bench.dispatcher.resume(in_flight=())


@pytest.mark.parametrize("name", ["toolplan.plan", "placement.locate"])
@pytest.mark.parametrize("cancelled", [True, False])
async def test_broken_recorder_is_fail_stop_and_commands_are_answered(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, name: str, cancelled: bool
) -> None:
    def decision(*_: object, **__: object) -> asyncio.Future[None]:
        if not cancelled:
            raise ValueError("no such table")
        written: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        written.cancel()
        return written

    await bench.do("robot.connect")
    monkeypatch.setattr(bench.recorder, "decision", decision)
    async with asyncio.timeout(10.0):
        verdict = await bench.do(name)
    await settle()
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code, bench.holds) == ("unknown", "internal_error", 1)
    shown = bench.dispatcher.snapshot()
    assert (shown.running, shown.branches["toolplan"], shown.branches["placement"]) == ([], "0", "unknown")
