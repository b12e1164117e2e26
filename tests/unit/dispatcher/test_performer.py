"""Performed commands: in time, with the intent first, and held if a motion does not end well."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

from pcmrs.dispatcher import Run, command_checks
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.testing.clock import settle
from tests.unit.dispatcher.dispatcher_fakes import HELD, RETRACTED, STANDOFF, Bench, Notes, code


@pytest.mark.parametrize("name", ["placement.confirm", "teleoperation.engage"])
async def test_command_that_moves_or_acts_is_checked_soon_or_refused(bench: Bench, name: str) -> None:
    joint = STANDOFF if name == "placement.confirm" else ("111", "1", "1", "1", "guided", "0", "off")
    await bench.go(joint)
    bench.script.entered.clear()
    arrived = asyncio.get_running_loop().time() - 2 * command_checks.CHECKS_BEGIN_WITHIN
    verdict = await bench.dispatcher.submit(bench.command(name), arrived=arrived)
    await settle()
    assert (verdict.decision, code(verdict), bench.joint) == ("rejected", "expired", joint)
    assert (bench.recorder.kinds(verdict.id), verdict in bench.published) == (["decision"], True)
    assert bench.script.entered == []


async def test_command_that_neither_moves_nor_acts_may_start_late(bench: Bench) -> None:
    arrived = asyncio.get_running_loop().time() - 60.0
    assert (await bench.dispatcher.submit(bench.command("toolplan.plan"), arrived=arrived)).decision == "accepted"


@pytest.mark.parametrize("name", ["toolplan.clear", "toolplan.plan", "registration.clear_registration"])
async def test_retreat_does_not_end_at_a_standoff_that_has_changed(bench: Bench, name: str) -> None:
    await bench.go(HELD)
    at_the_end = bench.script.hang("placement.back_off")
    retreat = await bench.begin("placement.back_off")
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    change = await bench.begin(name)
    at_the_end.set()
    await settle()
    gate.set()
    assert (await change).decision == "accepted"
    assert (code(await retreat), bench.joint[4]) == ("outcome_outdated", "held")


async def test_retreat_does_not_end_at_a_plan_journalled_as_it_began(bench: Bench) -> None:
    await bench.go(HELD)
    gate = bench.recorder.gates["decision"] = asyncio.Event()
    plan = await bench.begin("toolplan.plan")
    retreat = await bench.begin("placement.back_off")
    gate.set()
    assert (await plan).decision == "accepted"
    assert (code(await retreat), bench.joint[4]) == ("outcome_outdated", "held")


async def test_03_a_motion_whose_hold_is_not_confirmed_is_unknown(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.hold_error = DeviceError("No answer.")
    verdict = await bench.take("placement", "approach", "failed")
    assert (verdict.decision, verdict.state) == ("unknown", "unknown")


@pytest.mark.parametrize("error", [DeviceError("No answer."), OSError("socket gone"), TimeoutError()])
async def test_04_whatever_hold_raises_it_is_not_confirmed(bench: Bench, error: Exception) -> None:
    await bench.go(STANDOFF)
    bench.hold_error = error
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.stop("test:operator")
    assert ((await task).decision, bench.joint[4]) == ("unknown", "unknown")


async def test_13_intent_precedes_the_first_step_and_outcome_the_reply(bench: Bench) -> None:
    """Both are in the journal by then."""
    seen: list[str] = []

    async def look(run: Run[Any, Notes]) -> None:
        seen.extend(bench.recorder.kinds(run.command.id))

    bench.script.steps["robot.connect"] = look
    verdict = await bench.do("robot.connect")
    assert set(seen) == {"intent"}
    assert bench.recorder.kinds(verdict.id) == ["intent", "decision"]
    assert not bench.recorder.with_intent[verdict.id]


async def test_13_one_commit_where_no_step_touches_the_world(bench: Bench) -> None:
    verdict = await bench.do("registration.plan_landmarks")
    assert bench.recorder.kinds(verdict.id) == ["decision"]
    assert bench.recorder.with_intent[verdict.id]


async def test_progress_is_published(bench: Bench) -> None:
    async def halfway(run: Run[Any, Notes]) -> None:
        run.progress(0.5)

    bench.script.steps["robot.connect"] = halfway
    await bench.do("robot.connect")
    assert 0.5 in [r.progress for snapshot in bench.snapshots() for r in snapshot.running]


async def test_stop_before_the_task_has_started(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    task = asyncio.create_task(bench.dispatcher.submit(bench.command("placement.approach")))
    await asyncio.sleep(0)  # the command is admitted in this turn of the loop; its task runs in the next
    await bench.dispatcher.stop("test:operator")
    assert ((await task).decision, code(await task)) == ("failed", "stopped")
    assert (bench.script.entered, bench.joint) == ([], HELD)


async def test_stop_while_the_intent_is_journalled(bench: Bench) -> None:
    await bench.go(RETRACTED)
    bench.script.entered.clear()
    gate = bench.recorder.gates["intent"] = asyncio.Event()
    task = await bench.begin("placement.approach")
    stop = asyncio.create_task(bench.dispatcher.stop("test:operator"))
    await settle()
    assert bench.holds > 0, "the hold waits for no journal"
    gate.set()
    await stop
    assert (code(await task), bench.script.entered, bench.joint) == ("stopped", [], HELD)


async def test_stop_cannot_be_swallowed_by_a_step(bench: Bench) -> None:
    await bench.go(STANDOFF)

    async def stubborn(run: Run[Any, Notes]) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.Event().wait()

    bench.script.steps["placement.confirm"] = stubborn
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.stop("test:operator")
    assert (code(await task), bench.joint) == ("stopped", HELD)


async def test_a_step_may_say_on_stop_that_nobody_knows(bench: Bench) -> None:
    await bench.go(STANDOFF)

    async def silent(run: Run[Any, Notes]) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            raise UnknownOutcomeError("The robot is silent.") from None

    bench.script.steps["placement.confirm"] = silent
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.stop("test:operator")
    assert ((await task).decision, bench.joint[4]) == ("unknown", "unknown")


async def test_the_hold_after_stop_can_use_a_deadline(bench: Bench) -> None:
    """The cancellation ends with the steps, or `asyncio.timeout` in the hold would take it for its caller's."""
    await bench.go(STANDOFF)
    cancelling: list[int] = []

    async def hold() -> None:
        task = asyncio.current_task()
        assert task is not None
        cancelling.append(task.cancelling())

    bench.hold = hold
    bench.script.hang("placement.confirm")
    task = await bench.begin("placement.confirm")
    await bench.dispatcher.stop("test:operator")
    await task
    assert cancelling
    assert not any(cancelling)


async def test_an_acknowledgement_releases_the_devices_first(bench: Bench) -> None:
    await bench.go(HELD)
    await bench.dispatcher.stop("test:operator")
    bench.release_error = DeviceError("The robot still moves.", code="moving")
    refused = await bench.do("robot.acknowledge")
    assert (refused.decision, code(refused)) == ("failed", "moving")
    assert bench.dispatcher.snapshot().latched, "a robot that moves is not released"
    bench.release_error = None
    bench.still_latched = ["stimulator"]
    accepted = await bench.do("robot.acknowledge")
    assert (accepted.decision, accepted.result) == ("accepted", {"still_latched": ["stimulator"]})
    assert not bench.dispatcher.snapshot().latched, "a silent stimulator keeps nobody from retreating"
