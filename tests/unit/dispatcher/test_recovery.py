"""Resuming after a failed journal: held, latched, and with what the disk says; and what settles unknown outcomes."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.dispatcher.events import EarlierDecision
from pcmrs.dispatcher.recovery import PendingOutcomes
from pcmrs.errors import JournalError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, UnknownOutcome, Verdict
from pcmrs.testing.clock import settle
from tests.support.shipped import shipped_blueprint
from tests.unit.dispatcher.dispatcher_fakes import HELD, PLACED, RETRACTED, STANDOFF, Bench


def reasons(verdict: Verdict) -> tuple[str, str]:
    return verdict.decision, "" if verdict.reason is None else verdict.reason.code


async def test_it_resumes_latched_and_moves_only_after_acknowledgement(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("placement.home")
    bench.recorder.failing.clear()
    holds = bench.holds
    await bench.dispatcher.resume(in_flight=())
    assert bench.dispatcher.broken is None
    assert bench.holds > holds, "the arm is held again before anything else may be asked for"
    assert bench.dispatcher.snapshot().latched
    assert ("event", "journal_reopened") in [(kind, name) for kind, name, _, _ in bench.recorder.rows]
    assert reasons(await bench.do("placement.home")) == ("rejected", "latched")
    assert (await bench.do("robot.acknowledge")).decision == "accepted"
    assert (await bench.do("placement.home")).decision == "accepted"


async def test_unconfirmed_standstill_is_journalled_when_it_resumes(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("placement.home")
    bench.recorder.failing.clear()
    bench.hold_error = UnknownOutcomeError("The robot is silent.")
    await bench.dispatcher.resume(in_flight=())
    assert bench.dispatcher.in_doubt
    assert bench.recorder.rows[-1][:2] == ("event", "hold_not_confirmed")


async def test_a_decision_that_the_disk_has_after_all_is_committed(bench: Bench) -> None:
    """The failed write had reached the disk: its states and data are in force, and a repeat gets its verdict."""
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    answered = await bench.do("toolplan.clear", id="clear-1")
    assert answered.decision == "unknown"
    assert bench.joint == RETRACTED
    bench.recorder.failing.clear()
    durable = Verdict(id="clear-1", branch="toolplan", operation="clear", decision="accepted", state="0", sequence=99)
    bench.recorder.earlier["test:user", "clear-1"] = EarlierDecision(durable, {})
    await bench.dispatcher.resume(in_flight=())
    assert bench.joint[2] == "0"
    (reopened,) = [states for _, name, states, _ in bench.recorder.rows if name == "journal_reopened"]
    assert reopened == bench.dispatcher.procedure.joint(), "later rows show what the disk has, too"
    assert await bench.do("toolplan.clear", id="clear-1") == durable
    assert durable in bench.published
    assert bench.dispatcher.snapshot().unknown == []


async def test_a_decision_that_the_disk_has_not_is_as_if_never_asked(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.clear", id="clear-1")
    assert [each.operation for each in bench.dispatcher.snapshot().unknown] == ["clear"]
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    assert bench.joint == RETRACTED
    assert bench.dispatcher.snapshot().unknown == []
    assert (await bench.do("toolplan.clear", id="clear-1")).decision == "accepted", "a repeat is decided anew"


async def test_rejection_that_was_not_written_is_decided_again(bench: Bench) -> None:
    bench.recorder.failing.add("decision")
    assert (await bench.do("robot.connect", id="c1")).decision == "unknown"
    assert reasons(await bench.do("toolplan.plan", id="p1")) == ("rejected", "journal_unavailable")
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    assert (await bench.do("toolplan.plan", id="p1")).decision == "accepted"


async def test_unwritten_outcome_of_a_motion_makes_placement_unknown(bench: Bench) -> None:
    """Never its source: the arm has moved. `locate` settles it."""
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("placement.approach", id="a1")
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight={("test:user", "a1")})
    assert bench.joint[4] == "unknown"
    (shown,) = bench.dispatcher.snapshot().unknown
    assert (shown.command, shown.source, shown.branch, shown.operation) == ("a1", "test:user", "placement", "approach")
    assert bench.recorder.kinds("a1") == ["intent", "decision"]
    assert (await bench.do("placement.approach", id="a1")).decision == "unknown"
    await bench.do("robot.acknowledge")
    assert bench.dispatcher.snapshot().unknown == [shown], "acknowledging does not say where the arm is"
    await bench.do("placement.locate")
    assert bench.dispatcher.snapshot().unknown == []


async def test_journal_that_fails_again_leaves_commands_refused(bench: Bench) -> None:
    """The placement is unknown after it."""
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("placement.approach", id="a1")
    bench.recorder.failing.add("event")
    with pytest.raises(PcmrsError):
        await bench.dispatcher.resume(in_flight={("test:user", "a1")})
    assert bench.dispatcher.broken is not None
    assert (await bench.do("toolplan.clear")).decision == "rejected"
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight={("test:user", "a1")})
    assert bench.joint[4] == "unknown"
    assert (await bench.do("toolplan.clear")).decision == "accepted"


async def test_outcome_that_could_not_be_looked_up_stays_unknown(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("placement.approach", id="a1")
    bench.recorder.failing = {"recall"}
    with pytest.raises(JournalError):
        await bench.dispatcher.resume(in_flight={("test:user", "a1")})
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight={("test:user", "a1")})
    assert bench.joint[4] == "unknown"


async def test_earlier_acknowledgement_does_not_answer_the_failure(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    bench.recorder.failing.add("decision")
    asked = {"stop": bench.dispatcher.stop_number}
    await bench.do("robot.acknowledge", id="ack", arguments=asked)
    bench.recorder.failing.clear()
    durable = Verdict(id="ack", branch="robot", operation="acknowledge", decision="accepted", state="1", sequence=99)
    bench.recorder.earlier["test:user", "ack"] = EarlierDecision(durable, asked)
    await bench.dispatcher.resume(in_flight=())
    assert bench.dispatcher.snapshot().latched


async def test_journal_continues_with_the_present_states(bench: Bench) -> None:
    """Not with those of the decision that was never written."""
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.clear")
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    (states,) = [states for _, name, states, _ in bench.recorder.rows if name == "journal_reopened"]
    assert tuple(states.values()) == RETRACTED
    await bench.do("robot.acknowledge")
    assert tuple(bench.recorder.rows[-1][2].values()) == RETRACTED


async def test_a_state_whose_activity_has_ended_is_left(bench: Bench) -> None:
    """Nobody watched the alignment meanwhile: the coil does not count as placed."""
    await bench.go(PLACED)
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.no_such_operation")
    await settle()
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    assert bench.joint == HELD
    assert "watch_alignment ends" in bench.script.log


async def test_device_event_during_the_failure_is_taken_in(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.recorder.failing.add("decision")
    await bench.do("robot.no_such_operation")
    await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="Silent.", danger=True))
    assert bench.joint[3] == "1"
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    assert (bench.joint[3], bench.joint[4]) == ("0", "unknown")


@pytest.mark.parametrize("failing", ["decision", "recall"])
async def test_device_event_that_met_the_failure_is_taken_in(bench: Bench, failing: str) -> None:
    """Its report is durable, and the operation on it is the first thing that is not."""
    await bench.go(STANDOFF)
    bench.recorder.failing.add(failing)
    await bench.dispatcher.report(DeviceEvent(device="robot", code="link_lost", text="Silent.", danger=True))
    assert bench.dispatcher.broken is not None
    assert bench.joint[3] == "1"
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    assert (bench.joint[3], bench.joint[4]) == ("0", "unknown")


async def test_device_report_that_reached_the_disk_is_taken_in_once(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.recorder.failing.add("decision")
    await bench.do("robot.link_lost", id="l1", source="device:robot")
    bench.recorder.failing.clear()
    durable = Verdict(id="l1", branch="robot", operation="link_lost", decision="accepted", state="0", sequence=99)
    bench.recorder.earlier["device:robot", "l1"] = EarlierDecision(durable, {})
    await bench.dispatcher.resume(in_flight=())
    assert (bench.joint[3], bench.joint[4]) == ("0", "unknown")
    assert [each.id for each in bench.verdicts() if each.operation == "link_lost"] == ["l1", "l1"]


async def test_queued_device_report_waits_until_the_journal_returns(bench: Bench) -> None:
    await bench.go(STANDOFF)
    bench.script.hang("placement.confirm")
    running = await bench.begin("placement.confirm")
    waiting = await bench.begin("robot.link_lost", source="device:robot")
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.no_such_operation")
    assert [(await each).decision for each in (running, waiting)] == ["unknown", "rejected"]
    bench.recorder.failing.clear()
    await bench.dispatcher.resume(in_flight=())
    assert (bench.joint[3], bench.joint[4]) == ("0", "unknown")


async def test_running_step_is_waited_for_and_the_resume_times_out(bench: Bench) -> None:
    await bench.go(RETRACTED)
    release = asyncio.Event()

    async def insist(_run: object) -> None:
        while not release.is_set():
            try:
                await release.wait()
            except asyncio.CancelledError:
                continue

    bench.script.steps["placement.approach"] = insist
    motion = await bench.begin("placement.approach")
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.clear")
    bench.recorder.failing.clear()
    resumed = asyncio.create_task(bench.dispatcher.resume(in_flight=()))
    await settle()
    await bench.clock.advance(60.0)
    release.set()
    with pytest.raises(PcmrsError, match=r"placement\.approach has not ended"):
        await resumed
    assert bench.dispatcher.broken is not None
    await motion


async def test_an_error_of_the_program_is_not_resumed(bench: Bench) -> None:
    async def keep_nonsense(run: object) -> None:
        run.keep(no_such_field=1)  # type: ignore[attr-defined]

    bench.script.steps["toolplan.plan"] = keep_nonsense
    await bench.do("toolplan.plan")
    with pytest.raises(PcmrsError, match="Only a restart"):
        await bench.dispatcher.resume(in_flight=())
    assert (await bench.do("toolplan.clear")).decision == "rejected"


async def test_a_working_dispatcher_is_not_disturbed(bench: Bench) -> None:
    await bench.go(PLACED)
    await bench.dispatcher.resume(in_flight=())
    assert (bench.joint, bench.dispatcher.snapshot().latched) == (PLACED, False)


async def test_an_ending_daemon_is_not_brought_back(bench: Bench) -> None:
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.clear")
    bench.recorder.failing.clear()
    await bench.dispatcher.close()
    with pytest.raises(PcmrsError):
        await bench.dispatcher.resume(in_flight=())
    assert reasons(await bench.do("toolplan.clear")) == ("rejected", "ending")


async def test_daemon_that_ends_while_it_resumes_is_not_resumed(bench: Bench) -> None:
    bench.recorder.failing.add("decision")
    await bench.do("toolplan.clear")
    bench.recorder.failing.clear()
    gate = bench.recorder.gates["event"] = asyncio.Event()
    resumed = asyncio.create_task(bench.dispatcher.resume(in_flight=()))
    await settle()
    closing = asyncio.create_task(bench.dispatcher.close())
    await settle()
    gate.set()
    await asyncio.gather(resumed, closing)
    assert reasons(await bench.do("toolplan.plan")) == ("rejected", "ending")


async def test_rows_journalled_as_a_resume_is_cancelled_are_published(bench: Bench) -> None:
    """A daemon that ends cancels its resume: nobody waits for the verdict any more; what follows from it happens."""
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("placement.approach", id="a1")
    bench.recorder.failing.clear()
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    resumed = asyncio.create_task(bench.dispatcher.resume(in_flight={("test:user", "a1")}))
    await settle()
    bench.published.clear()
    resumed.cancel()
    gate.set()
    await settle()
    assert resumed.cancelled()
    assert bench.joint[4] == "unknown"
    assert [(each.id, each.decision) for each in bench.verdicts()] == [("a1", "unknown")]
    assert bench.snapshots()[-1].branches["placement"] == "unknown"
    assert await bench.do("placement.approach", id="a1") == bench.verdicts()[0], "and who asks again hears it"


async def test_user_command_during_the_failure_is_not_done_later(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.recorder.failing.add("decision")
    await bench.do("robot.no_such_operation")
    assert (await bench.do("robot.disconnect")).decision == "rejected"
    bench.recorder.failing.clear()
    bench.script.entered.clear()
    await bench.dispatcher.resume(in_flight=())
    await settle()
    assert (bench.script.entered, bench.joint) == ([], RETRACTED)


async def test_unknown_outcomes_of_an_earlier_run_keep_the_latch(bench: Bench) -> None:
    lost = UnknownOutcome(command="c", source="bus:local", branch="robot", operation="connect", since=5.0)
    moved = UnknownOutcome(command="d", source="bus:local", branch="placement", operation="home", since=6.0)
    bench.dispatcher.restore(latched=True, unknown=[lost, moved])
    shown = bench.dispatcher.snapshot()
    assert (shown.latched, shown.unknown) == (True, [lost, moved])
    await bench.do("robot.connect")
    assert bench.dispatcher.snapshot().unknown == [moved]
    await bench.do("placement.locate")
    shown = bench.dispatcher.snapshot()
    assert (shown.latched, shown.unknown) == (True, [])
    await bench.do("robot.acknowledge")
    assert not bench.dispatcher.snapshot().latched


async def test_of_an_operation_that_stays_unknown_the_newest_is_shown(bench: Bench) -> None:
    bench.script.end("robot.connect", "unknown")
    for name in ("c1", "c2", "c3"):
        await bench.do("robot.connect", id=name)
    assert [each.command for each in bench.dispatcher.snapshot().unknown] == ["c3"]


BLUEPRINT = shipped_blueprint("ratms_threshold")


SETTLING = {
    "stimulation.fire": {"robot.acknowledge"},
    "stimulation.arm": {"robot.acknowledge"},
    "threshold.pulse": {"robot.acknowledge"},
    "stimulation.set_intensity": {
        "robot.acknowledge",
        *(f"stimulation.{name}" for name in ("set_ceiling", "set_intensity", "arm", "disarm", "fire")),
    },
    "placement.home": {
        f"placement.{name}" for name, spec in BLUEPRINT.branches["placement"].operations.items() if spec.steps
    },
}


@pytest.mark.parametrize("name", SETTLING)
def test_only_some_operations_settle_what_is_unknown(name: str) -> None:
    branch, operation = name.split(".")
    unknown = UnknownOutcome(command="c", source="test:user", branch=branch, operation=operation, since=5.0)
    settling = set()
    for other, declared in BLUEPRINT.branches.items():
        for each in declared.operations:
            unsettled = PendingOutcomes(BLUEPRINT, [unknown])
            unsettled.settle_by(other, each)
            if not unsettled.shown():
                settling.add(f"{other}.{each}")
    assert settling == SETTLING[name]
