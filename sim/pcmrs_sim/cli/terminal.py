"""Lines and signals that a running command gets from its terminal."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress


def termination() -> asyncio.Event:
    """Return an event that SIGTERM or SIGINT sets, in the running event loop."""
    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    return ended


def forward_lines(take: Callable[[str], object]) -> None:
    """Call a function in the running event loop for each line of standard input that is not blank.

    A thread reads: standard input may be a terminal, a pipe or a file, and an event loop cannot wait for a file.

    Args:
        take: Called with each line.
    """
    loop = asyncio.get_running_loop()

    def read() -> None:
        with suppress(RuntimeError, OSError):  # the loop has ended; another program reads from the terminal
            for line in filter(str.strip, sys.stdin):
                loop.call_soon_threadsafe(take, line)

    # In the background of a shell ("pcmrs-sim cell &"), reading from the terminal would stop the whole process.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    threading.Thread(target=read, name="standard input", daemon=True).start()
