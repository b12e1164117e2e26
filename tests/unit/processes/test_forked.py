"""The fork server as a process: what it answers to a request, and when it ends; see also `test_fork_server.py`."""

from __future__ import annotations

import array
import errno
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from pcmrs.processes import forked
from pcmrs.processes.forked import LARGEST, Ended, ForkAnswer, ForkRequest, Started, StartFailed
from tests import ROOT

WITHIN = 60.0
SERVER = """
import errno, os, signal, socket, sys
from pcmrs.processes import forked

def refuse(*_):
    raise OSError(errno.EAGAIN, "no more processes")

fork = os.fork

def refuse_once():
    os.fork = fork
    refuse()

match sys.argv[2]:
    case "no pidfd": os.pidfd_open = refuse
    case "full": os.fork = refuse_once
forked.serve_forks(socket.socket(fileno=int(sys.argv[1])), ["child"])
"""
CHILD = """
import os, sys

def main():
    sys.exit(int(sys.argv[1]) if sys.argv[1:] else None)
"""


@contextmanager
def server(folder: Path, case: str = "") -> Iterator[tuple[socket.socket, subprocess.Popen[bytes]]]:
    """Run a server that knows a module `child`, and end it with its socket."""
    (folder / "child.py").write_text(CHILD)
    ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
    ours.settimeout(WITHIN)
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-c", SERVER, str(theirs.fileno()), case],
            pass_fds=[theirs.fileno()],
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))},
        )
    try:
        with ours:
            yield ours, process
        assert process.wait(WITHIN) == (1 if case == "no pidfd" else 0)
    finally:
        process.kill()


def ask(control: socket.socket, number: int, *words: str) -> None:
    request = ForkRequest(number, "child", words, (), silent=False)
    control.send(msgspec.json.encode(request))


def answer(control: socket.socket) -> tuple[ForkAnswer, list[int]]:
    message, descriptors, *_ = socket.recv_fds(control, LARGEST, 1)
    return msgspec.json.decode(message, type=ForkAnswer), list(array.array("i", descriptors))


@pytest.mark.parametrize(("words", "status"), [((), 0), (("0",), 0), (("5",), 5)])
def test_a_child_is_reported_when_it_starts_and_ends(tmp_path: Path, words: tuple[str, ...], status: int) -> None:
    with server(tmp_path) as (control, _):
        ask(control, 3, *words)
        started, (process,) = answer(control)
        assert isinstance(started, Started)
        assert started.number == 3
        assert answer(control) == (Ended(started.pid, status), [])
        with pytest.raises(ProcessLookupError):  # the descriptor is that of this child, whose id may be used again
            signal.pidfd_send_signal(process, signal.SIGTERM)
        os.close(process)


def test_a_machine_without_room_for_a_process_is_reported(tmp_path: Path) -> None:
    with server(tmp_path, "full") as (control, _):
        ask(control, 1)
        assert answer(control) == (StartFailed(1, errno.EAGAIN), [])
        ask(control, 2)
        started, (process,) = answer(control)
        os.close(process)
        assert isinstance(started, Started), "the server goes on"
        assert started.number == 2


def test_machine_without_descriptors_of_processes_has_no_server(tmp_path: Path) -> None:
    with server(tmp_path, "no pidfd") as (control, process):
        assert process.wait(WITHIN) == 1
        assert control.recv(LARGEST) == b"", "the daemon sees that it has ended, and starts its children itself"


def test_descriptors_may_trade_their_numbers() -> None:
    (first, into_first), (second, into_second) = os.pipe(), os.pipe()
    forked._renumber([first, second], [second, first])
    os.write(into_first, b"1")
    os.write(into_second, b"2")
    assert (os.read(second, 1), os.read(first, 1)) == (b"1", b"2")
    for each in (first, into_first, second, into_second):
        os.close(each)
