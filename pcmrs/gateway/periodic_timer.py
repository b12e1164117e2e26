"""Work at a steady rate, in real time by a timer of the kernel: those of the event loop are whole milliseconds."""

from __future__ import annotations

import asyncio
import ctypes
import os
import time
from collections.abc import AsyncGenerator, Callable

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock

Beats = Callable[[float], AsyncGenerator[None]]
"""Yields at once and then once per period, s; beats missed in a stall are dropped."""

_log = structlog.get_logger(__name__)

_libc = ctypes.CDLL(None, use_errno=True)


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Timer(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("first", _Timespec))


def beats_of(clock: Clock) -> Beats:
    """Return beats that sleep by `clock`."""

    async def beats(period: float) -> AsyncGenerator[None]:
        due = clock.monotonic()
        while True:
            yield
            now = clock.monotonic()
            due = max(due + period, now)
            await clock.sleep(due - now)

    return beats


async def kernel_beats(period: float) -> AsyncGenerator[None]:
    """Yield once per `period`, s, by a timer of the kernel, timerfd_create(2)."""
    loop = asyncio.get_running_loop()
    timer = _timer(period)
    beat = asyncio.Event()

    def expired() -> None:
        os.read(timer, 8)  # the number of expirations: they make one beat
        beat.set()

    loop.add_reader(timer, expired)
    try:
        while True:
            yield
            await beat.wait()
            beat.clear()
    finally:
        loop.remove_reader(timer)
        os.close(timer)


def _timer(period: float) -> int:
    """A file that becomes readable each `period`, s."""
    timer: int = _libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    every = _Timespec(*divmod(max(1, round(period * 1e9)), 10**9))  # 0 would never expire
    if timer < 0 or _libc.timerfd_settime(timer, 0, ctypes.byref(_Timer(every, every)), None) != 0:
        failed = OSError(ctypes.get_errno(), "timerfd")
        if timer >= 0:
            os.close(timer)
        raise failed
    return timer


class PeriodicTask:
    """Function that is called at a steady rate between `start` and `stop`, also while the network fails.

    Args:
        beats: Source of the rate.
        rate_hz: Calls per second.
        tick: The function.
        tasks: Owner of the task.
    """

    def __init__(self, beats: Beats, rate_hz: float, tick: Callable[[], None], tasks: BackgroundTasks) -> None:
        self._beats = beats
        self._period = 1.0 / rate_hz
        self._tick = tick
        self._tasks = tasks
        self._task: asyncio.Task[None] | None = None
        self._failing = False

    def start(self) -> None:
        """Start, unless it runs."""
        if self._task is None or self._task.done():
            self._task = self._tasks.spawn(self._repeat())

    def stop(self) -> None:
        """Stop, if it runs."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _repeat(self) -> None:
        async for _ in self._beats(self._period):
            self._try()

    def _try(self) -> None:
        """Call the function; of several failures in a row only the first is logged."""
        try:
            self._tick()
        except OSError as error:
            if not self._failing:
                _log.warning("not_sent", tick=self._tick.__qualname__, reason=str(error))
            self._failing = True
        else:
            self._failing = False
