"""The process that plans: without it, or when it is lost, the answer is a refusal, and it is restarted."""

from __future__ import annotations

import asyncio
import pickle
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.errors import RefusalError
from pcmrs.messages import DeviceEvent, Reason
from pcmrs.processes.starting import start_by_exec
from pcmrs.service.processes.planner import PAUSE, PLANNING_TIME, PlanningProcess
from pcmrs.service.supervisor import RESTARTS, Supervisor
from pcmrs.settings import Settings
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.planning import PlanAnswer
from pcmrs.workflows.planning_process import HEADER, frame_message
from pcmrs.workflows.settings import CalibrationSettings
from tests.support.shipped import shipped_blueprint

ANSWER = PlanAnswer(Reason(code="unreachable", text="0.9 m away."), None, {}, [])


class FakeProcess:
    """Keeps what it is sent, and answers when the test says so."""

    def __init__(self) -> None:
        self.stdin, self.stdout = self, asyncio.StreamReader()
        self.sent: list[tuple[int, Any]] = []
        self.status: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    def write(self, data: bytes) -> None:
        number, length = HEADER.unpack(data[: HEADER.size])
        assert len(data) == HEADER.size + length
        self.sent.append((number, pickle.loads(data[HEADER.size :])))

    async def answer(self, number: int, answer: object) -> None:
        self.stdout.feed_data(frame_message(number, pickle.dumps(answer)))
        await settle()

    async def end(self, status: int) -> None:
        self.stdout.feed_eof()
        self.status.set_result(status)
        await settle()

    async def wait(self) -> int:
        return await asyncio.shield(self.status)

    def kill(self) -> None:
        self.stdout.feed_eof()
        self.status.set_result(-9)


class Bench:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.supervisor = Supervisor(self.clock)
        self.processes: list[FakeProcess] = []
        self.events: list[DeviceEvent] = []
        self.planner = PlanningProcess(Settings(), self.clock, start_by_exec)
        self.planner.report = self.events.append
        self.planner._begin = cast(Any, self._begin)  # type: ignore[method-assign]

    async def _begin(self) -> FakeProcess:
        self.processes.append(FakeProcess())
        return self.processes[-1]

    @property
    def process(self) -> FakeProcess:
        return self.processes[-1]

    async def ask(self, request: object) -> asyncio.Task[PlanAnswer]:
        asked = asyncio.create_task(self.planner._ask(cast(Any, request), "placement.approach"))
        await settle()
        return asked


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    async with made.supervisor:
        cell = cast("Cell", SimpleNamespace(surface=None, mounting=Mounting.read(CalibrationSettings())))
        made.planner.start(made.supervisor, shipped_blueprint("ratms"), cell)
        await settle()
        yield made


async def refused(asked: asyncio.Task[PlanAnswer]) -> RefusalError:
    with pytest.raises(RefusalError) as raised:
        await asked
    return raised.value


async def test_answers_go_to_their_requests_in_any_order(bench: Bench) -> None:
    await bench.process.answer(0, None)
    first, second = await bench.ask("first"), await bench.ask("second")
    numbers = {request: number for number, request in bench.process.sent}
    other = PlanAnswer(None, "trajectory", {}, [])
    await bench.process.answer(numbers["second"], other)
    await bench.process.answer(12345, ANSWER)  # to nobody
    await bench.process.answer(numbers["first"], ANSWER)
    assert (await first, await second) == (ANSWER, other)


async def test_before_it_is_ready_nothing_is_sent(bench: Bench) -> None:
    assert (await refused(await bench.ask("early"))).refusal_code == "planner_lost"
    assert bench.process.sent == []
    waiting = asyncio.create_task(bench.planner.wait())
    await settle()
    assert not waiting.done()
    await bench.process.answer(0, None)
    await waiting


async def test_process_that_ends_refuses_its_requests_and_is_restarted(bench: Bench) -> None:
    await bench.process.answer(0, None)
    asked = await bench.ask("lost")
    await bench.process.end(-11)
    error = await refused(asked)
    assert (error.refusal_code, error.fields) == ("planner_lost", {"status": -11})
    (event,) = bench.events
    assert (event.code, event.danger) == ("planner_restarted", False)
    assert len(bench.processes) == 2
    assert (await refused(await bench.ask("again"))).refusal_code == "planner_lost", "the new one is not ready"
    await bench.process.answer(0, None)
    asked = await bench.ask("again")
    await bench.process.answer(bench.process.sent[-1][0], ANSWER)
    assert await asked == ANSWER


async def test_late_process_is_a_refusal_with_its_limit(bench: Bench) -> None:
    await bench.process.answer(0, None)
    asked = await bench.ask("slow")
    await bench.clock.advance(PLANNING_TIME - 0.01)
    assert not asked.done()
    await bench.clock.advance(0.02)
    error = await refused(asked)
    assert (error.refusal_code, error.fields) == ("planner_late", {"limit": PLANNING_TIME})
    assert len(bench.processes) == 2, "it was killed"


async def test_process_that_keeps_ending_is_restarted_after_a_pause(bench: Bench) -> None:
    for _ in range(RESTARTS + 1):
        await bench.process.end(1)
    assert len(bench.processes) == RESTARTS + 1
    await bench.clock.advance(PAUSE)
    assert len(bench.processes) == RESTARTS + 2


async def test_answer_that_cannot_be_read_is_an_error_of_its_check(bench: Bench) -> None:
    await bench.process.answer(0, None)
    asked = await bench.ask("strange")
    bench.process.stdout.feed_data(frame_message(bench.process.sent[-1][0], b"no pickle"))
    with pytest.raises(pickle.UnpicklingError):
        await asked
