"""The driver of the cell in its own process: a world that does not answer is killed, and its end is an error."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import UnknownOutcomeError
from pcmrs_sim.process import driver
from pcmrs_sim.process.driver import open_devices

CLOCK = SystemClock()
Popen = subprocess.Popen


def replace_world(monkeypatch: pytest.MonkeyPatch, program: str) -> list[subprocess.Popen[bytes]]:
    """Let the driver start another program as its world, and return the processes that it starts."""
    started: list[subprocess.Popen[bytes]] = []

    def start(_command: list[str], *, stdin: int, start_new_session: bool) -> subprocess.Popen[bytes]:
        assert start_new_session, "Ctrl-C must not reach the world before its node has held the arm"
        started.append(Popen([sys.executable, "-c", program], stdin=stdin, start_new_session=start_new_session))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    return started


async def test_a_world_that_ends_before_it_is_open_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    started = replace_world(monkeypatch, "raise SystemExit(3)")
    with pytest.raises(UnknownOutcomeError, match="has ended"):
        async with asyncio.timeout(30.0), open_devices(("robot",), {}, CLOCK):
            pass
    assert started[0].returncode == 3


async def test_a_world_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    started = replace_world(monkeypatch, "import time; time.sleep(1000)")
    monkeypatch.setattr(driver, "END_TIME", 0.1)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.2), open_devices(("robot",), {}, CLOCK):
            pass
    assert started[0].returncode == -9


async def test_no_socket_is_left_open(monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[socket.socket] = []
    pair = socket.socketpair

    def remember() -> tuple[socket.socket, socket.socket]:
        ends.extend(pair())
        return ends[0], ends[1]

    replace_world(monkeypatch, "pass")
    monkeypatch.setattr(socket, "socketpair", remember)
    with pytest.raises(UnknownOutcomeError):
        async with asyncio.timeout(30.0), open_devices(("robot",), {}, CLOCK):
            pass
    assert [end.fileno() for end in ends] == [-1, -1]


def test_the_node_of_simulated_devices_runs_without_numpy() -> None:
    """Its loop has the deadman: what it runs imports neither NumPy nor the simulation."""
    code = "import sys, pcmrs.devices.node, pcmrs_sim.process.driver; "
    code += "print(*sorted({'numpy', 'mujoco', 'scipy', 'pcmrs.settings'} & set(sys.modules)))"
    imported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert imported.stdout.split() == []
