"""Time from the start of a process to what its user waits for: the daemon, and commands of `pcmrs`.

- `daemon`: the whole daemon with its simulated cell, recorder and console, started as a user starts it. `ready` is the
  line that says so; `answer` the first verdict to a command, asked for over UDP from the start on, without a pause.
- `commands`: processor and wall time of `pcmrs --help` and, at a running daemon, `pcmrs state`.

Beside them: a Python process that does nothing.

    .venv/bin/python benchmarks/start.py [--runs 5] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from pcmrs.gateway.grammar import format_command
from pcmrs.testing.daemon import free_port, own_settings, running_daemon


def ended(*command: str) -> tuple[float, float]:
    """Run a command to its end; return its wall and processor time, s.

    Args:
        command: Words of the command.
    """
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


async def answered(port: int, begin: float) -> float:
    """Return the time from `begin` to the first verdict that comes back to a planner, s.

    Args:
        port: Port of the planner's link, which need not be open yet.
        begin: Start of the daemon, on the clock of `time.perf_counter`.
    """
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.setblocking(False)
        client.connect(("127.0.0.1", port))
        number = 0
        while True:
            number += 1
            with contextlib.suppress(OSError, TimeoutError):
                client.send(format_command("start_registrati", client_id=str(number)))
                if await asyncio.wait_for(loop.sock_recv(client, 2048), 0.05):
                    return time.perf_counter() - begin
            await asyncio.sleep(0.01)


async def start(folder: Path, script: str) -> dict[str, float]:
    """Start a daemon; return the times until it is ready and until its first answer, and of `pcmrs state`, s.

    Args:
        folder: Empty folder of the cell.
        script: Path of `pcmrs`.
    """
    port = free_port()
    settings = own_settings(folder / "cell", "benchmark")
    settings = [each for each in settings if not each.startswith(("recording.", "console.", "gateway.planner"))]
    settings += [f"console.port={free_port()}", f"gateway.planner.port={port}"]
    begin = time.perf_counter()
    first = asyncio.create_task(answered(port, begin))
    async with running_daemon(settings, folder / "daemon.log") as daemon:
        ready = time.perf_counter() - begin
        found = {"ready": ready, "answer": await first}
        wall, processor = await asyncio.to_thread(
            ended, script, "state", "--cell", "benchmark", "--endpoint", daemon.ready.endpoint
        )
    return found | {"pcmrs state": wall, "pcmrs state, processor": processor}


def measure(runs: int) -> dict[str, float]:
    """Return the medians of all times, s.

    Args:
        runs: Number of runs, in which all take turns.
    """
    script = str(Path(sys.executable).parent / "pcmrs")
    times: dict[str, list[float]] = {}

    def add(found: dict[str, float]) -> None:
        for name, value in found.items():
            times.setdefault(name, []).append(value)

    for _ in range(runs):
        for name, command in {"python": (sys.executable, "-c", ""), "pcmrs --help": (script, "--help")}.items():
            wall, processor = ended(*command)
            add({name: wall, f"{name}, processor": processor})
        with tempfile.TemporaryDirectory() as folder:
            add(asyncio.run(start(Path(folder), script)))
    return {name: round(median(found), 3) for name, found in times.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = measure(arguments.runs)
    if arguments.json:
        print(json.dumps(found))
        return
    print(f"{os.cpu_count()} cores, medians of {arguments.runs} runs: s")
    for name, value in found.items():
        print(f"  {name:<26} {value:8.3f}")


if __name__ == "__main__":
    main()
