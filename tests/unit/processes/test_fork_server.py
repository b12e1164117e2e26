"""The fork server: children are as if a new Python ran their module, and go on when the server does not."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.processes import fork_server
from pcmrs.processes.fork_server import UNKNOWN_STATUS, ForkServer
from pcmrs.testing.daemon import command_line
from tests import ROOT

WITHIN = 60.0
SERVER = "import socket, sys; from pcmrs.processes import forked; "
SERVER += "forked.serve_forks(socket.socket(fileno=int(sys.argv[1])), ['child', 'no_such_module'])"
CHILD = """
import atexit, os, signal, socket, sys

atexit.register(sys.stderr.write, "the parent ends")

def main():
    word = sys.argv[1]
    if word == "echo":
        print(sys.argv, os.getsid(0) == os.getpid(), sys.stdin.readline().strip(), flush=True)
    elif word == "exit":
        sys.exit(int(sys.argv[2]))
    elif word == "say":
        sys.exit("it cannot run")
    elif word == "fail":
        raise ValueError("it has failed")
    elif word == "register":
        atexit.register(os.write, 2, b"the child ends")
        sys.exit(0)
    elif word == "accept":
        socket.socket(fileno=int(sys.argv[2])).accept()[0].sendall(b"accepted")
    elif word == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdin.read()

if __name__ == "__main__":
    main()
"""


class Bench:
    """A server in its own process, which knows a module `child`."""

    def __init__(self, folder: Path) -> None:
        (folder / "child.py").write_text(CHILD)
        self.errors = folder / "errors"
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        with self.errors.open("wb") as errors, theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVER, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stderr=errors,
                env={**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))},
            )
        self.start = ForkServer(ours, self.process.pid)

    def close(self) -> None:
        self.start.close()
        self.process.wait(WITHIN)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    made.close()


async def status_of(bench: Bench, *words: str) -> int:
    async with asyncio.timeout(WITHIN):
        process = await bench.start("child", *words)
        return await process.wait()


async def test_child_has_its_words_its_streams_and_its_own_session(bench: Bench) -> None:
    async with asyncio.timeout(WITHIN):
        process = await bench.start("child", "echo", "a b", stdout=PIPE)
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(b"hello\n")
        assert await process.stdout.readline() == b"['child', 'echo', 'a b'] True hello\n"
        assert command_line(process.pid) == [sys.executable, "-m", "child", "echo", "a", "b"]
        assert process.returncode is None
        process.stdin.close()  # as when the daemon ends
        assert await process.wait() == process.returncode == 0


async def test_given_input_and_silent_output(bench: Bench, capfd: pytest.CaptureFixture[str]) -> None:
    reading, writing = os.pipe()
    async with asyncio.timeout(WITHIN):
        process = await bench.start("child", "echo", stdin=reading, stdout=DEVNULL)
        os.close(reading)
        os.write(writing, b"hello\n")
        os.close(writing)
        assert await process.wait() == 0
    assert (process.stdin, process.stdout) == (None, None)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("lost", [False, True])
async def test_passed_descriptor_keeps_its_number(bench: Bench, lost: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a new Python is started, because the server is lost."""
    monkeypatch.setenv("PYTHONPATH", str(bench.errors.parent))
    if lost:
        bench.process.kill()
        bench.process.wait(WITHIN)
    async with asyncio.timeout(WITHIN):
        with socket.create_server(("127.0.0.1", 0)) as listening:
            reader, writer = await asyncio.open_connection(*listening.getsockname())
            number = listening.fileno()
            process = await bench.start("child", "accept", str(number), stdout=PIPE, passed=number)
            assert await reader.read() == b"accepted"
            writer.close()
        assert process.stdin is not None
        process.stdin.close()
        assert await process.wait() == 0


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("exit", "0"), 0, ""),
        (("exit", "7"), 7, ""),
        (("say",), 1, "it cannot run"),
        (("fail",), 1, "ValueError: it has failed"),
        (("register",), 0, "the child ends"),
        (("kill",), -signal.SIGKILL, ""),
    ],
)
async def test_child_ends_as_a_new_python_would(bench: Bench, words: tuple[str, ...], status: int, said: str) -> None:
    assert await status_of(bench, *words) == status
    errors = bench.errors.read_text()
    assert said in errors
    assert bool(said) == bool(errors)
    assert "the parent ends" not in errors


async def test_many_children_at_once_get_their_own_ends(bench: Bench) -> None:
    statuses = [*range(20)]
    assert await asyncio.gather(*(status_of(bench, "exit", str(each)) for each in statuses)) == statuses


async def test_module_that_does_not_exist_is_the_childs_error(bench: Bench) -> None:
    async with asyncio.timeout(WITHIN):
        assert await (await bench.start("no_such_module")).wait() == 1
        assert await status_of(bench, "exit", "3") == 3, "the server goes on"
    assert "No module named 'no_such_module'" in bench.errors.read_text()


async def test_killed_child_is_killed_and_a_late_signal_goes_nowhere(bench: Bench) -> None:
    async with asyncio.timeout(WITHIN):
        process = await bench.start("child", "wait")
        process.terminate()
        assert await process.wait() == -signal.SIGTERM
        process.kill()
        assert await process.communicate() == (b"", None)


async def test_children_outlive_a_killed_server(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(bench.errors.parent))
    async with asyncio.timeout(WITHIN):
        process = await bench.start("child", "echo", stdout=PIPE)
        bench.process.kill()
        bench.process.wait(WITHIN)
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(b"still here\n")
        assert b"still here" in await process.stdout.readline()
        later = await bench.start("pcmrs.cli", "--version", stdout=PIPE)
        assert later.stdout is not None
        assert b"version" in await later.stdout.read()
        assert await later.wait() == 0
        process.kill()
        assert await process.wait() == UNKNOWN_STATUS


async def test_starts_at_the_death_of_the_server_all_succeed(bench: Bench) -> None:
    """Its death is not noticed yet, and then noticed by several at once."""
    async with asyncio.timeout(WITHIN):
        assert await status_of(bench, "exit", "0") == 0
        bench.process.kill()
        bench.process.wait(WITHIN)
        started = await asyncio.gather(*(bench.start("pcmrs.cli", "--version", stdout=DEVNULL) for _ in range(2)))
        assert [await each.wait() for each in started] == [0, 0]


async def test_server_that_hangs_is_given_up(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    async with asyncio.timeout(WITHIN):
        assert await status_of(bench, "exit", "0") == 0
        bench.process.send_signal(signal.SIGSTOP)
        monkeypatch.setattr(fork_server, "ANSWER_TIME", 0.05)
        later = await bench.start("pcmrs.cli", "--version", stdout=PIPE)
        assert await later.wait() == 0
    with pytest.raises(ProcessLookupError):
        os.kill(bench.process.pid, 0)


async def test_start_that_is_given_up_leaves_no_child(bench: Bench) -> None:
    """It ends with its input."""
    async with asyncio.timeout(WITHIN):
        starting = asyncio.create_task(bench.start("child", "wait"))
        await asyncio.sleep(0)
        starting.cancel()
        await asyncio.gather(starting, return_exceptions=True)
        assert await status_of(bench, "exit", "0") == 0
        while bench.start._children:  # noqa: ASYNC110  only the operating system knows
            await asyncio.sleep(0.01)


async def test_server_ends_with_its_daemon(bench: Bench) -> None:
    async with asyncio.timeout(WITHIN):
        assert await status_of(bench, "exit", "0") == 0
    bench.start._control.shutdown(socket.SHUT_RDWR)
    assert bench.process.wait(WITHIN) == 0
