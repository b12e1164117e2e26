"""The process that sends the daemon's heartbeats: signs of life go out as they are, and none is invented."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

from pcmrs.bus import BusSettings
from pcmrs.bus.heart import SIGN, read_signs, runaway_event
from pcmrs.bus.seal import Seal, new_key, new_run
from pcmrs.clock import SystemClock
from pcmrs.messages import Beat, DeviceEvent
from pcmrs.processes.starting import start_by_exec
from pcmrs.service.processes.heart import ANSWER_TIME, HeartProcess
from pcmrs.service.supervisor import RESTARTS, Supervisor
from pcmrs.threads import Runaway
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus


@dataclass
class Bench:
    """A heart, and a router that hears it."""

    heart: HeartProcess
    beats: asyncio.Queue[Beat] = field(default_factory=asyncio.Queue)
    events: asyncio.Queue[DeviceEvent] = field(default_factory=asyncio.Queue)

    async def sign_until_heard(self) -> Beat:
        """Signs of life until one has arrived: the process takes its time to start."""
        async with asyncio.timeout(TIMEOUT):
            while self.beats.empty():
                self.heart.sign(time.monotonic())
                await asyncio.sleep(0.01)
        return self.beats.get_nowait()


@asynccontextmanager
async def opened() -> AsyncIterator[Bench]:
    settings = new_cell()
    key = new_key() + new_run()
    async with open_bus(settings, Seal(key, daemon=True)) as router:
        bench = Bench(HeartProcess(client_of(settings), SystemClock(), key, start_by_exec))
        bench.heart.report = bench.events.put_nowait
        router.subscribe("daemon/beat", Beat, lambda _, beat: bench.beats.put_nowait(beat))
        async with Supervisor(SystemClock()) as supervisor:
            bench.heart.start(supervisor)
            yield bench
        await bench.heart.stop()


async def test_beat_carries_the_loops_sign_and_stops_if_the_loop_hangs() -> None:
    """A loop that hangs gives no signs, and the heart then sends no beats."""
    async with opened() as bench:
        first = await bench.sign_until_heard()
        assert first.session == bench.heart.session
        assert first.alive <= first.sent
        while not bench.beats.empty():
            bench.beats.get_nowait()
        given = time.monotonic() - 5.0
        bench.heart.sign(given)
        async with asyncio.timeout(TIMEOUT):
            while (last := await bench.beats.get()).alive != given:
                assert last.number > first.number
        await bench.heart.stop()
        assert bench.beats.empty(), "the loop gives no more signs, so there are no more beats"


async def test_killed_heart_is_restarted_in_its_session_then_given_up() -> None:
    """It is given up after as many restarts as are allowed."""
    async with opened() as bench:
        for _ in range(RESTARTS + 1):
            before = await bench.sign_until_heard()
            (pid,) = children()
            os.kill(pid, signal.SIGKILL)
            event = await asyncio.wait_for(bench.events.get(), TIMEOUT)
            while not bench.beats.empty():
                bench.beats.get_nowait()
            bench.heart.sign(time.monotonic())  # to nobody: it neither blocks nor fails
            if event.danger:
                break
            after = await bench.sign_until_heard()
            assert (event.code, after.session) == ("heart_restarted", before.session)
            assert after.number > before.number
        assert (event.code, event.danger) == ("heart_failed", True)
        assert children() == []


async def test_hung_heart_is_restarted_but_not_after_a_silent_loop() -> None:
    async with opened() as bench:
        first = await bench.sign_until_heard()
        bench.heart.record_beat()
        bench.heart.sign(first.alive + 100.0)  # so long after the last one
        bench.heart.sign(first.alive + 100.0 + 0.9 * ANSWER_TIME)
        (pid,) = children()
        os.kill(pid, signal.SIGSTOP)
        bench.heart.sign(first.alive + 100.0 + 1.1 * ANSWER_TIME)
        assert (await asyncio.wait_for(bench.events.get(), TIMEOUT)).code == "heart_restarted"
        assert children() != [pid]


async def test_it_imports_neither_numpy_nor_the_simulation() -> None:
    code = (
        "import sys, pcmrs.bus.heart; print(*sorted({'numpy', 'mujoco', 'scipy', 'pcmrs.settings'} & set(sys.modules)))"
    )
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", code, stdout=asyncio.subprocess.PIPE)
    assert (await process.communicate())[0] == b"\n"


def test_newest_of_queued_signs_is_sent_however_they_are_cut() -> None:
    reading, writing = os.pipe()
    packed = b"".join(SIGN.pack(number, number / 10) for number in range(1, 4))
    os.write(writing, packed[:40])
    signs = read_signs(reading)
    assert next(signs) == (2, 0.2)
    os.write(writing, packed[40:])
    assert next(signs) == (3, 0.3)
    os.close(writing)
    assert list(signs) == []
    os.close(reading)


def test_event_says_if_a_runaway_thread_has_kept_its_policy() -> None:
    lost = runaway_event("daemon", Runaway(7, 8, "app-0", 0.34))
    kept = runaway_event("daemon", Runaway(7, 8, "app-0", 0.34, "Operation not permitted"))
    assert (lost.code, kept.code) == ("thread_demoted", "thread_not_demoted")
    assert lost.text.startswith("Thread app-0 (8) of process 7 ran for 0.3 s without a pause and has lost")
    assert "could not be taken away: Operation not permitted." in kept.text


def client_of(settings: BusSettings) -> BusSettings:
    return BusSettings(mode="client", endpoint=settings.endpoint, site=settings.site, cell=settings.cell)


def children() -> list[int]:
    """Of this process, those that are hearts."""
    found = [int(pid) for each in Path("/proc/self/task").glob("*/children") for pid in each.read_text().split()]
    return [pid for pid in found if b"pcmrs.bus.heart" in Path(f"/proc/{pid}/cmdline").read_bytes()]
