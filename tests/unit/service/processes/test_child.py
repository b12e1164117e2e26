"""Child processes get the daemon's settings, are restarted within limits, and are never a reason to stop anything."""

from __future__ import annotations

import asyncio
import stat
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from pcmrs.clock import SystemClock
from pcmrs.messages import DeviceEvent
from pcmrs.processes.starting import Process, start_by_exec
from pcmrs.service.processes.child import ChildProcess, end_child, open_child
from pcmrs.service.supervisor import RESTARTS, Supervisor
from pcmrs.settings import CellSettings, Inherited, Settings
from pcmrs.testing.clock import ManualClock, settle

WITHIN = 30.0


class FakeChild:
    """A process that ends when the test says so, or when its standard input does."""

    def __init__(self) -> None:
        self.ended: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.stdin = self

    def close(self) -> None:
        if not self.ended.done():
            self.ended.set_result(0)

    async def wait(self) -> int:
        return await asyncio.shield(self.ended)


class Bench:
    """A child that is kept running, and what is reported of it."""

    def __init__(self) -> None:
        self.children: list[FakeChild] = []
        self.error: OSError | None = None
        self.events: list[DeviceEvent] = []
        self.given_up = 0
        clock = ManualClock()
        self.supervisor = Supervisor(clock)
        begin = cast(Callable[[], Awaitable[Process]], self._begin)
        self.child = ChildProcess("recording", begin, self.events.append, clock, WITHIN, self._give_up)

    async def _begin(self) -> FakeChild:
        if self.error is not None:
            raise self.error
        self.children.append(FakeChild())
        return self.children[-1]

    def _give_up(self) -> None:
        self.given_up += 1

    async def end(self, status: int) -> None:
        await settle()
        self.children[-1].ended.set_result(status)
        await settle()

    @property
    def codes(self) -> list[str]:
        return [event.code for event in self.events]


async def test_killed_child_is_restarted_until_its_limit() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.child.start(bench.supervisor)
        for _ in range(RESTARTS):
            await bench.end(-9)
        assert (bench.codes, bench.child.ended) == (["recording_restarted"] * RESTARTS, "")
        await bench.end(-9)
    assert bench.codes[-1] == "recording_ended"
    assert len(bench.children) == RESTARTS + 1
    assert bench.child.ended == "status -9"
    assert bench.given_up == 1, "when it is no longer restarted"
    assert not any(event.danger for event in bench.events), "the cell works on"
    assert bench.supervisor.died == 0


async def test_child_that_said_why_it_ends_is_not_restarted() -> None:
    """A new one would end for the same reason."""
    bench = Bench()
    async with bench.supervisor:
        bench.child.start(bench.supervisor)
        await bench.end(2)
    assert (bench.codes, len(bench.children), bench.child.ended) == (["recording_ended"], 1, "status 2")
    assert bench.events[0].fields == {"why": "status 2"}


async def test_child_that_cannot_be_started_does_not_end_the_daemon() -> None:
    bench = Bench()
    bench.error = OSError(28, "No space left on device")
    async with bench.supervisor:
        bench.child.start(bench.supervisor)
        await settle()
        await bench.child.stop()  # there is none
    assert (bench.codes, bench.child.ended) == (["recording_ended"], "No space left on device")


async def test_stopped_child_may_finish_its_work() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.child.start(bench.supervisor)
        await settle()
    await bench.child.stop()
    assert bench.children[0].ended.result() == 0, "its input has ended, and it was not killed"


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Takes the place of Python: writes down its words and what it reads, until its input ends."""
    file = tmp_path / "program"
    file.write_text(f'#!/bin/sh\necho "$@" > {tmp_path / "words"}\ncat > {tmp_path / "input"}\n')
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(sys, "executable", str(file))
    return tmp_path


async def test_child_inherits_settings_and_key_and_ends_with_its_input(program: Path) -> None:
    settings = Settings(cell=CellSettings(name="cell7"))
    process: Any = await open_child(start_by_exec, "record", "a b.mcap", settings=settings, device_key=b"k" * 32)
    await process.stdin.drain()
    process.stdin.close()  # as when the daemon is gone
    async with SystemClock().timeout(WITHIN):
        assert await process.wait() == 0
    assert (program / "words").read_text() == "-m pcmrs.cli record a b.mcap\n"
    line, end = (program / "input").read_bytes().split(b"\n")
    assert msgspec.json.decode(line, type=Inherited) == Inherited(settings=settings, device_key=b"k" * 32)
    assert end == b""


async def test_child_that_is_late_is_killed() -> None:
    process = await asyncio.create_subprocess_exec("sleep", "600")
    assert not await end_child(process, 0.01)
    assert process.returncode == -9
