"""A daemon as a child process: its own ports and folder, and an end with all its children."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import stat
import sys
from pathlib import Path

import msgspec
import pytest

from pcmrs.errors import DeviceError
from pcmrs.service import Ready
from pcmrs.settings import read_settings
from pcmrs.testing import daemon
from pcmrs.testing.daemon import device_key, free_port, log_tail, own_settings, running_daemon
from pcmrs.threads import descendants

READY = Ready("pcmrs/lab/c1", "tcp/127.0.0.1:1", {}, "/f", "/f/journal.sqlite", "ratms", 1.0)

PRETENDED = """
import subprocess, sys
subprocess.Popen([sys.executable, "-c", "import time; time.sleep(100)  # pcmrs"], stdout=subprocess.DEVNULL)
print(sys.argv[1], flush=True)
sys.stdin.read()
"""
"""A program in place of a daemon: it starts a child that outlives it, says that it is ready, and waits for its end."""


def exists(pid: int) -> bool:
    """Return whether a process runs; one that has ended and was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


async def gone(pids: list[int]) -> None:
    async with asyncio.timeout(10.0):
        while any(map(exists, pids)):  # noqa: ASYNC110 - processes tell nobody that they end
            await asyncio.sleep(0.01)


def test_a_free_port_is_free_for_both_protocols_and_never_linuxs() -> None:
    for _ in range(20):
        port = free_port()
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
            tcp.bind(("127.0.0.1", port))
            udp.bind(("127.0.0.1", port))
        assert 20_000 <= port < 32_768


def test_a_taken_port_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    taken, free = free_port(), free_port()
    drawn = iter((taken, taken, free))
    monkeypatch.setattr("random.SystemRandom.randrange", lambda *_: next(drawn))
    with socket.socket(type=socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", taken))
        assert free_port() == free


def test_own_settings_share_nothing_with_another_cell(tmp_path: Path) -> None:
    one, other = (read_settings(overrides=own_settings(tmp_path / name, name)) for name in ("one", "other"))
    assert (one.cell.name, one.cell.folder) == ("one", str(tmp_path / "one"))
    assert one.cell.endpoint != other.cell.endpoint
    assert not one.recording.enabled
    assert not one.console.enabled
    assert device_key(tmp_path / "one") != device_key(tmp_path / "other")


def test_a_device_key_is_made_once_for_its_owner_alone(tmp_path: Path) -> None:
    key = device_key(tmp_path / "new" / "cell")
    assert device_key(tmp_path / "new" / "cell") == key
    assert len(key) >= 32
    assert stat.S_IMODE((tmp_path / "new" / "cell" / daemon.DEVICE_KEY).stat().st_mode) == 0o600


@pytest.mark.parametrize("stopped", [False, True])
async def test_a_daemon_ends_with_its_context_and_its_children(tmp_path: Path, stopped: bool) -> None:
    """Also one that is stopped, as by a debugger."""
    prefix = (sys.executable, "-c", PRETENDED, msgspec.json.encode(READY).decode())
    async with running_daemon(["cell.name=c1"], tmp_path / "log", prefix=prefix) as running:
        assert running.ready == READY
        children = descendants(running.process.pid)
        assert len(children) == 1
        if stopped:
            for pid in (running.process.pid, *children):
                os.kill(pid, signal.SIGSTOP)
    assert running.process.returncode is not None
    await gone(children)


async def test_a_daemon_that_does_not_start_is_an_error_with_its_log(tmp_path: Path) -> None:
    program = "import os, sys; print('\\n'.join(['too early', 'one', 'two', os.environ['WHY']]), file=sys.stderr)"
    with pytest.raises(DeviceError, match="The daemon did not start: one two the port is taken") as error:
        async with running_daemon(
            [], tmp_path / "log", prefix=(sys.executable, "-c", program), environment={"WHY": "the port is taken"}
        ):
            raise AssertionError
    assert "too early" not in error.value.text


async def test_a_daemon_that_is_never_ready_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon, "START_TIME", 0.2)
    before = descendants(os.getpid())
    with pytest.raises(DeviceError, match=r"not ready within 0\.2 s"):
        async with running_daemon([], tmp_path / "log", prefix=(sys.executable, "-c", "input()")):
            raise AssertionError
    assert set(descendants(os.getpid())) <= set(before)


def test_the_end_of_a_log_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(b"first\nsecond \xff\nthird\n")
    assert log_tail(tmp_path / "log", 2) == "second \N{REPLACEMENT CHARACTER} third"
