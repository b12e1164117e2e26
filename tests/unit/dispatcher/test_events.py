"""The dispatcher's events, its journal, those who listen to it, and completed commands.

Events say what is dangerous and who is named, and their fields survive the journal. A row is queued at once, and one
that is lost is reported to its owner. Listeners learn of everything at once, and cannot break the dispatcher. A
completed command changes data only if it is accepted, and releases the latch only of Stops before it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.dispatcher import DispatcherListener
from pcmrs.dispatcher.events import (
    DAEMON,
    FAIL_STOP,
    REOPENED,
    CompletedCommand,
    QueuedRow,
    failed,
    not_confirmed,
    pressed_again,
    stopped,
)
from pcmrs.dispatcher.locks import Locks, PendingCommand
from pcmrs.dispatcher.workflow import ProcedureData, Run
from pcmrs.errors import JournalError
from pcmrs.messages import Command, Decision, DeviceEvent, Reason
from tests.unit.dispatcher.dispatcher_fakes import RATMS, RETRACTED, Bench, code

TOO_STRONG = Reason(code="force_limit", text="31 N, limit 30 N.", fields={"force": 31.0, "stop": -1})


def test_event_of_a_stop_has_its_number_beside_the_reason() -> None:
    """The number of the Stop is what an acknowledgement names: no field of the reason may hide it."""
    event = stopped("device:robot", TOO_STRONG, 7)
    assert (event.device, event.code, event.text, event.danger) == (
        "device:robot",
        "force_limit",
        TOO_STRONG.text,
        True,
    )
    assert event.fields == {"force": 31.0, "stop": 7}
    assert TOO_STRONG.fields["stop"] == -1, "the reason is as it was"


def test_failure_names_its_code_and_is_danger() -> None:
    event = failed(TOO_STRONG)
    assert (event.device, event.code, event.danger) == (DAEMON, FAIL_STOP, True)
    assert event.fields == {"reason": "force_limit"}


def test_doubt_and_reopening_are_danger_and_say_look() -> None:
    for event in (not_confirmed("bus:anna"), REOPENED):
        assert event.danger
        assert "look" in event.text


@given(joined=st.dictionaries(st.text(min_size=1), st.integers(1, 10**6), min_size=1), number=st.integers(1, 10**9))
def test_counted_presses_are_no_danger_and_survive_json(joined: dict[str, int], number: int) -> None:
    event = pressed_again("bus:eve", number, joined)
    assert not event.danger, "the Stop that they joined was"
    assert event.fields == {"stop": number, "presses": sum(joined.values()), "by": joined}
    assert f"{sum(joined.values())} more times" in event.text
    assert msgspec.json.decode(msgspec.json.encode(event), type=DeviceEvent) == event
    joined.clear()
    assert event.fields["by"], "later presses of the next Stop do not change it"


@pytest.mark.parametrize("fails", ["listener", "publisher"])
async def test_stop_works_although_a_listener_fails(bench: Bench, fails: str) -> None:
    class Failing(DispatcherListener):
        def on_stop(self) -> None:
            if fails == "listener":
                raise RuntimeError("The test wants it to fail.")

        def on_publish(self, _message: object) -> None:
            if fails == "publisher":
                raise RuntimeError("The test wants it to fail.")

    reported: list[str] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: reported.append(context["message"]))
    await bench.go(RETRACTED)
    bench.script.hang("placement.approach")
    motion = await bench.begin("placement.approach")
    bench.dispatcher.add_listener(Failing())
    assert await bench.dispatcher.stop("test:operator")
    assert code(await motion) == "stopped"
    assert reported


async def test_listeners_learn_of_every_stop_before_anything_else_runs(bench: Bench) -> None:
    told: list[bool] = []

    class Listener(DispatcherListener):
        def on_stop(self) -> None:
            told.append(bench.dispatcher.snapshot().latched)

    bench.dispatcher.add_listener(Listener())
    await bench.dispatcher.stop("test:operator")
    await bench.dispatcher.report(DeviceEvent(device="robot", code="force_limit", text="Too strong.", danger=True))
    assert told == [True, True]


STOPPED = Reason(code="stopped", text="Stopped by test:operator.")


async def completed(
    decision: Decision, operation: str = "robot.acknowledge", stopped: Reason | None = None
) -> CompletedCommand[Any, ProcedureData]:
    """An operation that has kept a plan and ended with `decision`."""
    branch, name = operation.split(".")
    command = Command(id="1", branch=branch, operation=name, source="test:user")
    run: Run[Any, ProcedureData] = Run(command, None, {}, None, SystemClock(), ProcedureData(), lambda fraction: None)
    run.keep(plan_id="p1")
    verdict = asyncio.get_running_loop().create_future()
    spec = RATMS.branches[branch].operations[name]
    pending = PendingCommand(command, spec, None, verdict, Locks(frozenset(), frozenset()), 0.0, side_effecting=False)
    pending.stopped = stopped
    return CompletedCommand(command, verdict, decision, pending=pending, run=run)


@pytest.mark.parametrize("decision", get_args(Decision))
async def test_only_an_accepted_command_changes_data(decision: Decision) -> None:
    changes = (await completed(decision)).changes
    assert changes == ({"plan_id": "p1"} if decision == "accepted" else {})


@pytest.mark.parametrize("decision", get_args(Decision))
async def test_only_an_accepted_acknowledgement_unlatches(decision: Decision) -> None:
    assert (await completed(decision)).unlatches == (decision == "accepted")
    assert not (await completed(decision, "robot.connect")).unlatches


async def test_acknowledgement_that_a_later_stop_met_releases_nothing() -> None:
    assert not (await completed("accepted", stopped=STOPPED)).unlatches


async def test_command_rejected_before_it_was_pending_changes_nothing() -> None:
    command = Command(id="1", branch="robot", operation="acknowledge", source="test:user")
    rejected: CompletedCommand[Any, ProcedureData] = CompletedCommand(
        command, asyncio.get_running_loop().create_future(), "accepted"
    )
    assert (rejected.changes, rejected.unlatches) == ({}, False)


@pytest.mark.parametrize("at_once", [True, False])
async def test_lost_row_is_reported_to_its_owner_and_not_raised(at_once: bool) -> None:
    """Whether the journal refuses to queue it or fails to write it."""
    lost = JournalError("The disk is full.")
    reported: list[JournalError] = []

    async def write() -> None:
        raise lost

    def queue() -> Awaitable[None]:
        if at_once:
            raise lost
        return write()

    await QueuedRow(queue, reported.append)
    assert reported == [lost]


async def test_row_is_queued_at_once_and_awaited_until_it_is_durable() -> None:
    """Commands that are submitted after it must be journalled after it."""
    durable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    queued: list[str] = []
    failed: list[JournalError] = []

    def queue() -> Awaitable[None]:
        queued.append("row")
        return durable

    row = asyncio.create_task(QueuedRow(queue, failed.append).durable())
    assert queued == ["row"]
    await asyncio.sleep(0)
    assert not row.done()
    durable.set_result(None)
    await row
    assert (queued, failed) == (["row"], [])
