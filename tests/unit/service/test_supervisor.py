"""Tasks that die are begun anew within their limits; beyond them the daemon stops safely and ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from pcmrs.errors import DeviceError, SupervisionError
from pcmrs.messages import DeviceEvent
from pcmrs.service.supervisor import REPORT_TIME, RESTARTS, WITHIN, RestartLimit, Supervisor, mark
from pcmrs.testing.clock import ManualClock, settle


class Bench:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.supervisor = Supervisor(self.clock)
        self.events: list[DeviceEvent] = []
        self.supervisor.report = self._report

    async def _report(self, event: DeviceEvent) -> None:
        self.events.append(event)


async def run(bench: Bench, start: Callable[[Supervisor], None]) -> None:
    """A daemon that runs for as long as its tasks let it."""
    async with bench.supervisor as supervisor:
        start(supervisor)
        await asyncio.Event().wait()


def dying(times: int, begun: list[int]) -> Callable[[], Coroutine[Any, Any, None]]:
    """Work that dies so many times, and then goes on for ever."""

    async def work() -> None:
        begun.append(len(begun))
        if len(begun) <= times:
            raise OSError("The cable is out.")
        await asyncio.Event().wait()

    return work


async def test_dead_task_is_logged_counted_reported_and_restarted() -> None:
    bench, begun = Bench(), list[int]()
    with capture_logs() as told:
        async with bench.supervisor as supervisor:
            supervisor.start("beats", dying(RESTARTS, begun))
            await settle()
            assert len(begun) == RESTARTS + 1
            assert supervisor.counters() == {"tasks.died": RESTARTS, "tasks.strays": 0, "restarts.beats": RESTARTS}
    assert [event.code for event in bench.events] == ["task_restarted"] * RESTARTS
    assert not any(event.danger for event in bench.events)
    assert [(each["event"], each["task"]) for each in told] == [("task_died", "beats")] * RESTARTS


async def test_one_death_too_many_is_danger_and_ends_the_daemon() -> None:
    """It ends with a typed error."""
    bench, begun = Bench(), list[int]()
    others = asyncio.Event()

    async def serve() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            others.set()

    def start(supervisor: Supervisor) -> None:
        supervisor.start("others", serve)
        supervisor.start("beats", dying(RESTARTS + 1, begun))

    with pytest.raises(SupervisionError, match=r"'beats' died more than 3 times .*The cable is out") as failed:
        await run(bench, start)
    assert isinstance(failed.value.__cause__, OSError)
    last = bench.events[-1]
    assert (last.code, last.danger, last.fields) == ("task_failed", True, {"task": "beats"})
    assert others.is_set()


async def test_a_task_that_simply_ends_has_died_too() -> None:
    bench = Bench()

    async def work() -> None:
        """Done."""

    with pytest.raises(SupervisionError, match="it ended by itself"):
        await run(bench, lambda supervisor: supervisor.start("watch", work))


class Panic(BaseException):
    """As a library in Rust raises it: no `Exception`."""


async def test_a_task_whose_library_panics_has_died_too() -> None:
    bench = Bench()

    async def work() -> None:
        raise Panic("index out of bounds")

    with pytest.raises(SupervisionError, match="Panic: index out of bounds"):
        await run(bench, lambda supervisor: supervisor.start("watch", work))
    assert [event.danger for event in bench.events[-2:]] == [False, True]


async def test_task_whose_inner_work_was_cancelled_counts_as_dead() -> None:
    bench = Bench()
    inner: list[asyncio.Future[None]] = []

    async def work() -> None:
        inner.append(asyncio.get_running_loop().create_future())
        await inner[-1]

    async with bench.supervisor as supervisor:
        supervisor.start("watch", work)
        await settle()
        inner[0].cancel()
        await settle()
        assert len(inner) == 2


async def test_a_stop_that_fails_ends_the_daemon_safely() -> None:
    bench = Bench()

    async def stop() -> bool:
        raise DeviceError("nobody knows the robot")

    with pytest.raises(SupervisionError, match="nobody knows the robot"):
        await run(bench, lambda supervisor: supervisor.spawn("stop by nurse", stop()))
    assert bench.events[-1].danger


async def test_stop_whose_inner_work_was_cancelled_ends_daemon_safely() -> None:
    bench = Bench()

    async def stop() -> None:
        raise asyncio.CancelledError

    with pytest.raises(SupervisionError, match="stop by nurse"):
        await asyncio.wait_for(run(bench, lambda supervisor: supervisor.spawn("stop by nurse", stop())), 10.0)
    assert bench.events[-1].danger


async def test_a_stop_that_hangs_does_not_keep_the_daemon_from_ending() -> None:
    bench = Bench()

    async def hang(_event: DeviceEvent) -> None:
        await asyncio.Event().wait()

    bench.supervisor.report = hang

    async def fail() -> None:
        raise OSError

    running = asyncio.create_task(run(bench, lambda supervisor: supervisor.start("watch", fail, restarts=0)))
    await settle()
    await bench.clock.advance(REPORT_TIME + 0.1)
    with pytest.raises(SupervisionError):
        await running


async def test_an_error_of_the_daemon_itself_stays_what_it_is() -> None:
    bench = Bench()

    def start(supervisor: Supervisor) -> None:
        supervisor.start("watch", dying(0, []))
        raise DeviceError("The robot is not heard.")

    with pytest.raises(DeviceError, match="not heard"):
        await run(bench, start)


@pytest.mark.parametrize("error", [Panic("the link is poisoned"), DeviceError("the link is poisoned")], ids=repr)
async def test_task_that_fails_at_the_end_raises_and_is_not_restarted(error: BaseException) -> None:
    bench = Bench()

    async def work() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            raise error

    async def run_and_end() -> None:
        async with bench.supervisor as supervisor:
            supervisor.start("watch", work)
            await settle()

    with pytest.raises(BaseExceptionGroup) as ended:
        await asyncio.wait_for(run_and_end(), 10.0)
    assert ended.group_contains(type(error), match="poisoned")


async def test_a_failure_that_is_nobodys_is_logged_and_counted() -> None:
    bench = Bench()

    def handler() -> None:
        raise OSError("not mine")

    with capture_logs() as told:
        async with bench.supervisor as supervisor:
            loop = asyncio.get_running_loop()
            loop.set_exception_handler(supervisor.handle_loop_exception)
            loop.call_soon(handler)
            await settle()
            assert supervisor.counters()["tasks.strays"] == 1
    assert [each["event"] for each in told] == ["stray_failure"]


async def test_a_task_answers_as_long_as_it_marks() -> None:
    bench = Bench()

    async def work() -> None:
        await bench.clock.sleep(5.0)
        mark()
        await asyncio.Event().wait()

    mark()  # of nobody's task: nothing happens
    async with bench.supervisor as supervisor:
        supervisor.start("watch", work, quiet=6.0)
        await settle()
        await bench.clock.advance(10.0)
        (status,) = supervisor.statuses()
        assert status.answers(bench.clock.monotonic())
        await bench.clock.advance(1.5)
        assert not status.answers(bench.clock.monotonic())


@given(st.lists(st.floats(0.0, 2 * WITHIN), max_size=30), st.integers(0, 5))
def test_the_limit_is_reached_by_that_many_deaths_in_any_window(gaps: list[float], restarts: int) -> None:
    clock = ManualClock()
    limit = RestartLimit(restarts, WITHIN, clock)
    deaths: list[float] = []
    for gap in gaps:
        clock.stall(gap)
        deaths.append(clock.monotonic())
        inside = [death for death in deaths if clock.monotonic() - death <= WITHIN]
        assert limit.reached() == (len(inside) > restarts)
