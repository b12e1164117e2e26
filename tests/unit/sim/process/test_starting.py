"""Start of a world: a fork before there are threads, otherwise a new Python; both end with the link."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT

WITHIN = 60.0
WORLD = """
import os, socket, sys

def main():
    link = socket.socket(fileno=0)
    told = f"{sys.argv} {os.getsid(0) == os.getpid()} {'numpy' in sys.modules}"
    link.send(told.encode())
    while link.recv(100):
        pass
    sys.exit(7)

if __name__ == "__main__":
    main()
"""
NODE = """
import asyncio, socket, subprocess, sys, threading
import numpy
from pcmrs.testing.daemon import command_line
from pcmrs_sim.process import starting

starting.MODULE = "world"

def start(kill=False):
    here, there = socket.socketpair()
    with there:
        world = starting.start_world(there, here)
    print(here.recv(1000).decode(), command_line(world.pid)[1:], flush=True)
    try:
        world.wait(0.0)
    except subprocess.TimeoutExpired:
        print("runs", flush=True)
    if kill:
        world.kill()
    else:
        here.close()
    print(type(world).__name__, world.wait(), world.wait(1.0), world.returncode, flush=True)
    world.kill()

async def start_in_loop():
    start()

match sys.argv[1]:
    case "first": start()
    case "killed": start(kill=True)
    case "loop": asyncio.run(start_in_loop())
    case "thread":
        ended = threading.Event()
        threading.Thread(target=ended.wait).start()
        start()
        ended.set()
"""


def said_by_node(folder: Path, case: str) -> list[str]:
    (folder / "world.py").write_text(WORLD)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))}
    command = [sys.executable, "-c", NODE, case]
    node = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=WITHIN)
    assert not node.stderr
    return node.stdout.splitlines()


@pytest.mark.parametrize(("case", "status"), [("first", 7), ("killed", -9)])
def test_world_is_a_fork_with_its_own_session(tmp_path: Path, case: str, status: int) -> None:
    told, runs, ended = said_by_node(tmp_path, case)
    assert told == "['world'] True True ['-m', 'world']", "a module of its node is there already"
    assert runs == "runs"
    assert ended == f"ForkedWorld {status} {status} {status}"


@pytest.mark.parametrize("case", ["loop", "thread"])
def test_world_is_a_new_python_when_a_fork_is_not_safe(tmp_path: Path, case: str) -> None:
    told, runs, ended = said_by_node(tmp_path, case)
    assert told.endswith("True False ['-m', 'world']"), "it has imported nothing that it does not need"
    assert runs == "runs"
    assert ended == "Popen 7 7 7"
