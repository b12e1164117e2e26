"""A device node ends with the daemon that started it: with its standard input, once."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs import node
from pcmrs.background import background_task
from pcmrs.clock import SystemClock
from pcmrs.node import watch_threads, when_input_ends
from pcmrs.processes.starting import Process, start_by_exec

WITHIN = 10.0


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The daemon's end of the pipe that is this process's standard input."""
    reading, writing = os.pipe()
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: reading))
    yield writing
    os.close(reading)


async def test_it_ends_once_when_the_daemon_is_gone(daemon: int) -> None:
    """The end of a file stays readable: it must not keep the loop busy."""
    ended = asyncio.Event()
    calls: list[None] = []

    def end() -> None:
        calls.append(None)
        ended.set()

    when_input_ends(end)
    await asyncio.sleep(0.02)
    assert calls == [], "the daemon lives"
    os.close(daemon)  # also what the kernel does when it is killed
    async with SystemClock().timeout(WITHIN):
        await ended.wait()
    await asyncio.sleep(0.02)
    assert calls == [None]


async def test_data_on_its_input_end_it_too(daemon: int) -> None:
    """The daemon sends nothing after the settings."""
    ended = asyncio.Event()
    when_input_ends(ended.set)
    os.write(daemon, b"\n")
    async with SystemClock().timeout(WITHIN):
        await ended.wait()
    os.close(daemon)


async def test_watcher_of_the_threads_is_restarted_when_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "RESTART_PAUSE", 0.0)
    started = asyncio.Queue[Process]()

    async def start(*words: str, **pipes: Any) -> Process:
        started.put_nowait(process := await start_by_exec(*words, **pipes))
        return process

    async with background_task(watch_threads(lambda _: None, start)), SystemClock().timeout(WITHIN):
        first = await started.get()
        first.kill()
        assert (await started.get()).pid != first.pid
