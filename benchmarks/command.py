"""Time from a UDP command to its verdict in the whole daemon, as a user runs it, compared with bare counterparts.

The daemon is `pcmrs-serve` with its simulated cell, recorder and console (which starts with the first page); one
planner sends one command after the other and waits for each verdict. `accepted` is the second half of a plan, which
changes a state and is committed; `rejected` is a registration without landmarks. In the same run, in turns: a bare
asyncio echo in a separate process, a bare SQLite commit with fsync in the same folder, and, where the Debian packages
`ros-core libroscpp-dev libstd-msgs-dev pkg-config g++` are installed, the paper's architecture as three roscpp nodes
(`ros1_chain`): UDP in, decode, dispatch, UDP out, without journal and rules.

The state is on the disk of temporary files (TMPDIR); `--ram` keeps it in memory, without the disk's flushes.

    .venv/bin/python benchmarks/command.py [--count 300] [--rounds 5] [--ram] [--quiet-cell]
        [--without-chain] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from dispatch import measure_commit, measure_plans, measure_udp, register_datagrams, spread

from pcmrs.testing.daemon import free_port, own_settings, running_daemon

RAM_DISK = "/dev/shm"  # noqa: S108 - the folder in it has a random name
CHAIN = Path(__file__).parent / "ros1_chain"
NODES = ("comm", "decode", "dispatcher")
CHAIN_COMMAND = b"start_registrat_" + b"_0.1_0.2_0.3_1.0_0.0_0.0_0.0"
CHAIN_PORT, MASTER_PORT = 8057, 11311
"""A command that the chain knows; the port of its first node, which its source fixes, and that of the ROS master."""

ECHO = """
import asyncio, sys

class Echo(asyncio.DatagramProtocol):
    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, address):
        self.transport.sendto(data, address)

async def main():
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(Echo, local_addr=("127.0.0.1", int(sys.argv[1])))
    print(flush=True)
    await asyncio.Event().wait()

asyncio.run(main())
"""


@contextlib.contextmanager
def running_echo() -> Iterator[int]:
    """Run the bare echo server in a separate process; yield its port."""
    port = free_port()
    process = subprocess.Popen([sys.executable, "-c", ECHO, str(port)], stdout=subprocess.PIPE)
    try:
        process.stdout.readline()  # type: ignore[union-attr]
        yield port
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def running_chain() -> Iterator[int | None]:
    """Compile and run the roscpp nodes and their master; yield the port, or None where ROS is not installed."""
    if not (shutil.which("rosmaster") and shutil.which("g++") and shutil.which("pkg-config")):
        yield None
        return
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        words = subprocess.run(
            ["pkg-config", "--cflags", "--libs", "roscpp", "std_msgs"], capture_output=True, text=True, check=True
        ).stdout.split()
        for node in NODES:
            source = str(CHAIN / f"{node}.cpp")
            subprocess.run(["g++", "-O2", "-o", f"{name}/{node}", source, *words, "-lpthread"], check=True)
        environment = os.environ | {
            "ROS_MASTER_URI": f"http://127.0.0.1:{MASTER_PORT}",
            "ROS_IP": "127.0.0.1",
            "ROS_LOG_DIR": name,
        }

        def start(*command: str) -> None:
            process = subprocess.Popen(
                command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
            )
            stack.callback(process.wait)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)

        start("rosmaster", "--core", "-p", str(MASTER_PORT))
        wait_for_master()
        for node in NODES:
            start(f"{name}/{node}")
        wait_for_answer(CHAIN_PORT)
        yield CHAIN_PORT


def wait_for_master() -> None:
    """Wait until the ROS master accepts connections.

    Raises:
        SystemExit: It did not within 30 s.
    """
    for _ in range(300):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", MASTER_PORT), 0.1):
            return
        time.sleep(0.1)
    raise SystemExit("the ROS master does not answer")


def wait_for_answer(port: int) -> None:
    """Wait until the chain answers a datagram: its nodes find each other a while after their start.

    Args:
        port: Port of the chain.

    Raises:
        SystemExit: It did not within 30 s.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(0.3)
        client.connect(("127.0.0.1", port))
        for _ in range(100):
            with contextlib.suppress(OSError):
                client.send(CHAIN_COMMAND)
                client.recv(4096)
                return
            time.sleep(0.2)  # a port that is not open yet refuses at once
    raise SystemExit("the roscpp chain does not answer")


async def measure(folder: Path, count: int, rounds: int, *, whole: bool, chained: bool) -> dict[str, dict[str, float]]:
    """Return the times of each kind of command.

    Args:
        folder: Folder of the cell.
        count: Commands of each kind in a round.
        rounds: Rounds, in which all kinds take turns.
        whole: True with recorder and console.
        chained: True with the roscpp nodes, where ROS is installed.
    """
    settings = own_settings(folder / "cell", "benchmark")
    if whole:
        settings = [each for each in settings if not each.startswith(("recording.", "console."))]
        settings.append(f"console.port={free_port()}")
    times: dict[str, list[list[float]]] = {}

    def add(name: str, found: list[float]) -> None:
        times.setdefault(name, []).append(found)

    with running_echo() as echo, running_chain() if chained else contextlib.nullcontext() as chain:
        async with running_daemon(settings, folder / "daemon.log") as daemon:
            port = daemon.ready.links["planner"][1]

            def turn() -> None:
                add("echo", measure_udp(echo, [b"x" * 30] * count))
                if chain is not None:
                    add("roscpp chain", measure_udp(chain, [CHAIN_COMMAND] * count))
                add("accepted", measure_plans(port, count))
                add("rejected", measure_udp(port, register_datagrams(count)))
                (folder / "commit.sqlite").unlink(missing_ok=True)
                add("commit", measure_commit(folder, count))

            await asyncio.to_thread(turn)  # not counted: it fills caches
            times.clear()
            for _ in range(rounds):
                await asyncio.to_thread(turn)
    # The median of the rounds' figures, so that one disturbed round changes little.
    return {
        name: {figure: median(spread(one)[figure] for one in found) for figure in ("p50", "p99", "max")}
        for name, found in times.items()
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300, help="commands of each kind in a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--ram", action="store_true", help="keep the state on a RAM disk")
    parser.add_argument("--without-chain", action="store_true", help="do not compile and run the roscpp nodes")
    parser.add_argument("--quiet-cell", action="store_true", help="without recorder and console")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=RAM_DISK if arguments.ram else None) as name:
        found = asyncio.run(
            measure(
                Path(name),
                arguments.count,
                arguments.rounds,
                whole=not arguments.quiet_cell,
                chained=not arguments.without_chain,
            )
        )
    if arguments.json:
        print(json.dumps(found))
        return
    print(f"{os.cpu_count()} cores, {arguments.rounds} rounds of {arguments.count} commands each: µs")
    print(f"  {'':<14} {'p50':>8} {'p99':>8} {'max':>8}")
    for kind, figures in found.items():
        print(f"  {kind:<14} {figures['p50']:8.0f} {figures['p99']:8.0f} {figures['max']:8.0f}")
    if "roscpp chain" not in found:
        print("  roscpp chain: not installed (ros-core libroscpp-dev libstd-msgs-dev pkg-config g++)")


if __name__ == "__main__":
    main()
