"""A steady rate, in real time by a timer of the kernel: those of the event loop are whole milliseconds."""

from __future__ import annotations

import asyncio
import ctypes
import os
import time
from collections.abc import AsyncGenerator, Callable

from pcmrs.clock import Clock

Beats = Callable[[float], AsyncGenerator[None]]
"""Yields now and then each so many seconds; beats missed in a stall are not made up for."""

_libc = ctypes.CDLL(None, use_errno=True)


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Timer(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("first", _Timespec))


def beats_of(clock: Clock) -> Beats:
    """Beats of any clock, by its sleep."""

    async def beats(period: float) -> AsyncGenerator[None]:
        due = clock.monotonic()
        while True:
            yield
            now = clock.monotonic()
            due = max(due + period, now)
            await clock.sleep(due - now)

    return beats


async def kernel_beats(period: float) -> AsyncGenerator[None]:
    """Beats of the machine's own clock, timerfd_create(2)."""
    loop = asyncio.get_running_loop()
    timer = _timer(period)
    beat = asyncio.Event()

    def expired() -> None:
        os.read(timer, 8)  # how many there were since the last look: one beat, however many
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
    every = _Timespec(*divmod(max(1, round(period * 1e9)), 10**9))  # 0 would mean that it never expires
    if timer < 0 or _libc.timerfd_settime(timer, 0, ctypes.byref(_Timer(every, every)), None) != 0:
        failed = OSError(ctypes.get_errno(), "timerfd")
        if timer >= 0:
            os.close(timer)
        raise failed
    return timer
