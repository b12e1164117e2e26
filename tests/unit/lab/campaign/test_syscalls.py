"""System calls are tampered with only once the tracer holds the process, and how many is counted."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from pcmrs_lab.campaign import syscalls
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.syscalls import injected
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started

OUTPUT = (
    b"[pid 7] fdatasync(5) = -1 EIO (Input/output error) (INJECTED)\n"
    b'[pid 7] write(5, "(INJECTED)", 10) = 10\n'
    b"[pid 8] fsync(6) = 0 (DELAYED)\n"
    b"strace: Process 4711 detached\n"
)


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Threads that the tracer holds, of the threads 1, 2 and 3."""
    traced = [1, 2, 3]
    monkeypatch.setattr(syscalls, "_threads", lambda _: [1, 2, 3])
    monkeypatch.setattr(syscalls, "_is_traced", lambda thread: thread in traced)
    return traced


@pytest.mark.usefixtures("held")
async def test_affected_calls_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = ScriptedChild(errors=OUTPUT)
    started(monkeypatch, tracer)
    async with injected(4711, ("fsync", "fdatasync"), "error=EIO", files=[Path("/a"), Path("/b")]) as tampered:
        pass
    assert tampered.calls == 2
    assert tracer.words == (
        *("strace", "-f", "-p", "4711", "-P", "/a", "-P", "/b"),
        *("-e", "trace=fsync,fdatasync", "-e", "inject=fsync,fdatasync:error=EIO"),
    )
    assert tracer.signals == [signal.SIGTERM]


async def test_the_main_thread_alone_may_be_held(monkeypatch: pytest.MonkeyPatch, held: list[int]) -> None:
    held[:] = [1]
    tracer = ScriptedChild()
    started(monkeypatch, tracer)
    async with injected(1, ("write",), "error=EIO", threads=False):
        assert "-f" not in tracer.words


async def test_a_tracer_that_cannot_attach_does_not_run_the_row(
    monkeypatch: pytest.MonkeyPatch, held: list[int]
) -> None:
    held[:] = [1]
    tracer = ScriptedChild()
    tracer.returncode = 1
    started(monkeypatch, tracer)
    with pytest.raises(NotRun, match="cannot attach"):
        async with injected(1, ("write",), "error=EIO"):
            pass


async def test_one_that_does_not_hold_all_threads_is_ended(monkeypatch: pytest.MonkeyPatch, held: list[int]) -> None:
    held[:] = [1, 2]
    tracer = ScriptedChild()
    started(monkeypatch, tracer)
    monkeypatch.setattr(syscalls, "ATTACHES_WITHIN", 0.01)
    with pytest.raises(NotRun, match=r"did not attach within 0\.01 s"):
        async with injected(1, ("write",), "error=EIO"):
            pass
    assert tracer.signals == [signal.SIGTERM]


async def test_nothing_is_traced_in_a_sham_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch)
    with sham():
        async with injected(1, ("write",), "error=EIO") as tampered:
            pass
    assert tampered.calls == 0


def test_a_thread_is_traced_or_has_ended() -> None:
    assert os.getpid() in syscalls._threads(os.getpid())
    assert not syscalls._is_traced(os.getpid())
    assert syscalls._is_traced(1 << 30), "it has ended"
