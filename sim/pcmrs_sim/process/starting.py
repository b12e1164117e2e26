"""Start of the process of a simulated world.

The world has its own session: Ctrl-C at the terminal then reaches the node only, which holds the arm first.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Protocol

from pcmrs.processes.forked import run_main

MODULE = "pcmrs_sim.process.world"
POLL_PERIOD = 0.01
"""Time between two looks if a forked process has ended, s."""


class WorldProcess(Protocol):
    """What is used of `subprocess.Popen`."""

    def wait(self, timeout: float | None = None) -> int: ...

    def kill(self) -> None: ...


class ForkedWorld:
    """A world that was forked; see `WorldProcess`.

    Args:
        pid: Id of the process, a child of this one.

    Attributes:
        pid: Id of the process.
        returncode: Exit status, or the negative number of the signal that ended it; None before `wait` has seen it.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; return its exit status.

        Raises:
            TimeoutExpired: It has not ended within `timeout`, s.
        """
        end = None if timeout is None else time.monotonic() + timeout
        while self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
            elif end is not None and time.monotonic() >= end:
                raise subprocess.TimeoutExpired(MODULE, timeout or 0.0)
            else:
                time.sleep(POLL_PERIOD)
        return self.returncode

    def kill(self) -> None:
        """Send SIGKILL."""
        if self.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


def start_world(theirs: socket.socket, ours: socket.socket) -> WorldProcess:
    """Start a world.

    It is a fork of this process, with its imports, if this process has no event loop and no other threads; otherwise
    it is a new Python.

    Args:
        theirs: Its end of the link, which becomes its standard input.
        ours: The other end, which it closes.
    """
    if not _may_fork():
        return subprocess.Popen([sys.executable, "-m", MODULE], stdin=theirs.fileno(), start_new_session=True)
    pid = os.fork()
    if pid:
        return ForkedWorld(pid)
    status = 1
    try:
        os.setsid()
        ours.close()  # otherwise the link would not end with the node
        os.dup2(theirs.fileno(), 0)
        theirs.close()
        status = run_main(MODULE, ())
    finally:
        os._exit(status)


def _may_fork() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return threading.active_count() == 1
    return False
