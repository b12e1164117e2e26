"""The process that reads an uploaded file can do nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.console.planning import confined
from pcmrs.console.planning.confined import landlock_version

CONFINED = """
import fcntl, mmap, os, resource, signal, socket, subprocess, sys, threading
from pcmrs.console.planning import confined

how, folder, terminal = sys.argv[1:]
os.chdir(folder)
go, out = threading.Event(), []
def beside():
    go.wait()
    tried("socket of another thread", socket.socket)
def tried(what, act, *words):
    try:
        act(*words)
    except (OSError, MemoryError, RuntimeError) as error:
        out.append(f"{what}: {type(error).__name__}")
    else:
        out.append(f"{what}: done")
def fork():
    if os.fork() == 0:
        os._exit(0)
def start_thread():
    thread = threading.Thread(target=print, args=("",), kwargs={"end": ""})
    thread.start()
    thread.join()
def read():
    with open("read", "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY) as mapped:
        assert mapped[:] == b"read"
    assert "read" in os.listdir(".")
    import colorsys
thread = threading.Thread(target=beside, daemon=True)
thread.start()
for name in ("read", "kept", "gone", "moved", "cut", "emptied", "locked", "closed"):
    with open(name, "w") as file:
        file.write(name)
file, locked = os.open("kept", os.O_WRONLY), os.open("locked", os.O_RDONLY)
parent = os.getppid()
if how == "filtered":
    confined._refuse_changes = lambda libc: None
if how != "free":
    confined.confine(2**30, 60)
tried("reading", read)
tried("socket", socket.socket)
tried("program", subprocess.run, ["true"])
tried("process", fork)
tried("thread", start_thread)
tried("memory", bytes, 2**31)
tried("write", os.write, file, b"x")
tried("make", os.open, "new", os.O_WRONLY | os.O_CREAT)
tried("unlink", os.unlink, "gone")
tried("rename", os.rename, "moved", "renamed")
tried("truncate", os.truncate, "cut", 0)
tried("truncate by opening", os.open, "emptied", os.O_RDONLY | os.O_TRUNC)
tried("chmod", os.chmod, "closed", 0)
tried("link", os.link, "read", "linked")
tried("mkdir", os.mkdir, "folder")
tried("lock", fcntl.flock, locked, fcntl.LOCK_EX)
tried("terminal", os.open, terminal, os.O_WRONLY | os.O_NOCTTY)
tried("new terminal", os.openpty)
tried("own memory", os.open, "/proc/self/mem", os.O_RDWR)
tried("signal", os.kill, parent, 0)
tried("signal by descriptor", lambda: signal.pidfd_send_signal(os.pidfd_open(parent), 0))
tried("signal by the kernel", fcntl.fcntl, locked, fcntl.F_SETOWN, parent)
tried("limits of another process", resource.prlimit, parent, resource.RLIMIT_CORE)
go.set()
thread.join()
print(*out, sep="\\n")
"""

SUCCEEDS = {"reading": "done"}
BY_LIMIT = {"memory": "MemoryError", "thread": "RuntimeError", "write": "OSError", "signal by descriptor": "OSError"}
REFUSED = "PermissionError"


@pytest.mark.parametrize("how", ["free", "filtered", "confined"])
def test_reader_reads_and_can_do_nothing_else(how: str, tmp_path: Path) -> None:
    """Also on a kernel without Landlock."""
    master, terminal = os.openpty()
    words = [sys.executable, "-c", CONFINED, how, str(tmp_path), os.ttyname(terminal)]
    said = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120).stdout.split("\n")
    os.close(master)
    os.close(terminal)
    tries = dict(line.split(": ") for line in said if line)
    assert len(tries) == 24
    expected = {what: (SUCCEEDS | BY_LIMIT).get(what, REFUSED) for what in tries}
    assert tries == (dict.fromkeys(tries, "done") if how == "free" else expected)


LANDLOCKED = """
import os, sys
from pcmrs.console.planning import confined

how, folder, other = sys.argv[1:]
if how == "confined":
    confined._filter_calls = lambda libc: None
    confined.confine(2**30, 60)
def tried(act, *words):
    try:
        act(*words)
        return "done"
    except OSError as error:
        return type(error).__name__
print(
    tried(os.unlink, f"{folder}/file"),
    tried(os.mkdir, f"{folder}/folder"),
    tried(os.open, f"{folder}/file", os.O_WRONLY | os.O_CREAT),
    tried(os.readlink, f"/proc/{other}/cwd"),
)
"""


@pytest.mark.skipif(not landlock_version(), reason="the kernel has no Landlock")
@pytest.mark.parametrize("how", ["free", "confined"])
def test_landlock_refuses_changes_without_the_filter(how: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with subprocess.Popen(["sleep", "600"]) as other:
        try:
            words = [sys.executable, "-c", LANDLOCKED, how, str(tmp_path), str(other.pid)]
            said = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120).stdout.split()
        finally:
            other.kill()
    assert said == ["PermissionError" if how == "confined" else "done"] * 4


@pytest.mark.parametrize("column", [0, 1])
def test_each_number_is_that_of_one_system_call(column: int) -> None:
    tables = [*confined._CALLS.values(), *(numbers for numbers, _ in confined._OPEN)]
    numbers = [each[column] for each in (*tables, confined._FCNTL, confined._PRLIMIT) if each[column] is not None]
    assert len(numbers) == len(set(numbers))
    newer = [number for number in numbers if number is not None and number >= confined._NEWER]
    assert newer == [439]
