"""The command pcmrs-sim as a real process."""

import json
import os
import pty
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

COMMAND = [sys.executable, "-c", "from pcmrs_sim.cli import main; main()"]
DEADLINE = 60.0
ENDED_BY_US = 0


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    pipe = subprocess.PIPE
    process = subprocess.Popen([*COMMAND, *arguments], stdin=pipe, stdout=pipe, stderr=pipe, text=True, bufsize=1)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def type_line(process: subprocess.Popen[str], line: str) -> None:
    assert process.stdin is not None
    process.stdin.write(f"{line}\n")


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def end(process: subprocess.Popen[str], number: signal.Signals) -> str:
    """What the process has said on standard error until it ended well."""
    process.send_signal(number)
    _, errors = process.communicate(timeout=DEADLINE)
    assert process.returncode == ENDED_BY_US
    assert "Traceback" not in errors
    return errors


@contextmanager
def cabinet_at(host: str, port: int) -> Iterator[Callable[[str], bytes]]:
    """A blocking client: asks a line, gets a line."""
    with socket.create_connection((host, port), timeout=DEADLINE) as link, link.makefile("rb") as replies:

        def ask(line: str) -> bytes:
            link.sendall(f"{line}\n".encode())
            return replies.readline()

        yield ask


def wait_for_emergency_stop(ask: Callable[[str], bytes]) -> None:
    while b"nak\n" not in (ask("startDirectServoJoints"), ask("stopDirectServoJoints")):
        pass


def test_a_cabinet_is_served_and_takes_faults_as_they_are_typed() -> None:
    with running("kst", "--port", "0", "--json") as process:
        host, port = json.loads(first_line(process))["kst"]
        with cabinet_at(host, port) as ask:
            assert len(ask("getJointsPositions").split(b"_")) == 8
            type_line(process, "e_stop on")
            wait_for_emergency_stop(ask)
        type_line(process, "nonsense on")
        type_line(process, "touch 99")
        assert process.stderr is not None
        said = ""
        while "Write touch and the number of a landmark" not in said:
            said += process.stderr.readline()
        assert "There is no fault 'nonsense'; `pcmrs-sim faults` lists them.\n" in said
        end(process, signal.SIGTERM)


def test_cell_serves_cabinet_and_tracker_and_follows_a_schedule(tmp_path: Path) -> None:
    schedule = tmp_path / "faults.txt"
    schedule.write_text("# at once\n0.0 e_stop on\n\n0.0 touch 0\n", encoding="utf-8")
    arguments = ("--kst-port", "0", "--ndi-port", "0", "--schedule", str(schedule), "--json")
    with running("cell", *arguments) as process:
        places = json.loads(first_line(process))
        with cabinet_at(*places["kst"]) as ask:
            wait_for_emergency_stop(ask)
        with socket.create_connection(places["ndi"], timeout=DEADLINE) as tracker:
            tracker.sendall(b"INIT:E3A5\r")
            assert tracker.recv(64).startswith(b"OKAY")
        end(process, signal.SIGINT)


def test_a_command_ends_by_itself_at_the_end_of_its_time() -> None:
    ended = subprocess.run(
        [*COMMAND, "ndi", "--pty", "--duration", "0.1"], input="", text=True, capture_output=True, timeout=DEADLINE
    )
    assert ended.returncode == 0
    assert "Traceback" not in ended.stderr
    assert ended.stdout.startswith("serving ndi on /dev/")


def test_it_runs_in_the_background_of_a_terminal() -> None:
    shell = "set -m; " + shlex.join([*COMMAND, "ndi", "--pty", "--duration", "0.5"]) + " & wait $!; echo status $?"
    child, terminal = pty.fork()
    if child == 0:
        os.execvp("bash", ["bash", "-c", shell])
    said = b""
    with suppress(OSError):  # the terminal is closed at its end
        while chunk := os.read(terminal, 4096):
            said += chunk
    os.close(terminal)
    os.waitpid(child, 0)
    assert b"status 0" in said
