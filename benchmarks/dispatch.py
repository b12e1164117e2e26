"""Time from a command to its decision: UDP and Zenoh, compared with a bare echo of the same kind, in one run.

Prints p50, p99 and max in µs and the ratio of the medians. The server runs in a separate process: the real gateway,
dispatcher, RATMS workflow and journal, without devices, since the requested commands need none
(`toolplan.plan`, accepted, changes a state; `registration.register`, rejected). Clients and servers share the machine.

    .venv/bin/python benchmarks/dispatch.py [--count 3000] [--warm-up 300] [--fsync with|without|both] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import platform
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
import uvloop
import zenoh

from pcmrs.bus import Bus, BusSettings, CommandEdge
from pcmrs.bus.commands import Envelope
from pcmrs.cli.log import log_to_stderr
from pcmrs.clock import SystemClock
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.remote import RemotePointer, RemoteRobot
from pcmrs.dispatcher import Dispatcher, DispatcherListener
from pcmrs.gateway.grammar import format_command
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from pcmrs.journal import Journal
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import BlueprintTag, DeviceEvent, Snapshot, Verdict
from pcmrs.service.gateway_adapter import GatewayAdapter
from pcmrs.service.publishing import Publishing
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.daemon import free_port
from pcmrs.threads import keep_pauses_short
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.opening import open_workflow
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.surface import read_surface

PAUSE = 0.0005  # s between commands; planners leave far more, so this measures latency and not throughput
PLAN = {"position": [0.0, 0.05, 0.1], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
FSYNC = {"without": ("without",), "with": ("with",), "both": ("without", "with")}


class Echo(asyncio.DatagramProtocol):
    """Bare echo server."""

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, address: Any) -> None:
        self.transport.sendto(data, address)


class Shown(DispatcherListener):
    """Publisher of the messages of a dispatcher on the bus, like the daemon."""

    def __init__(self, publishing: Publishing) -> None:
        self._publishing = publishing

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        self._publishing.publish(message)


async def nothing_to_hold(_latch: bool) -> None:
    """Do nothing: there is no arm for which the dispatcher's last Stop must wait."""


@contextlib.asynccontextmanager
async def running_server(endpoint: str, folder: Path, durable: bool) -> AsyncIterator[dict[str, int]]:
    """Run the server in this process; yield its ports.

    Args:
        endpoint: Zenoh endpoint of the bus.
        folder: Folder of the journal.
        durable: True to synchronise every commit.
    """
    loop, clock = asyncio.get_running_loop(), SystemClock()
    echo, _ = await loop.create_datagram_endpoint(Echo, local_addr=("127.0.0.1", 0))
    bus = await Bus.open(BusSettings(mode="router", endpoint=endpoint, cell="benchmark"))
    journal = Journal.open(folder / "journal.sqlite", durable=durable)
    workflow = open_workflow("ratms")
    blueprint = workflow.blueprint
    tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
    settings = ProcedureSettings()
    robot, pointer = RemoteRobot(bus, clock), RemotePointer(bus, clock, 1.0)
    poses, arm = PoseFeed(clock, 0.2), ArmModel(ARMS["iiwa14"])
    cell = Cell(robot, pointer, poses, arm, clock, settings, read_surface(settings))
    recorder = JournalRecorder(journal, clock, "benchmark", tag)
    dispatcher = Dispatcher(workflow, cell, clock, recorder, nothing_to_hold)
    dispatcher.add_listener(Shown(Publishing(bus)))
    edge = await CommandEdge.open(bus, dispatcher.submit, lambda *_: None, lambda _source, _presses: None)

    async def echo_query(_key: str, request: Envelope) -> Envelope:
        return request

    bus.serve("svc/echo", Envelope, echo_query)
    config = GatewayConfig(
        planner=LinkConfig(port=0),
        robot=LinkConfig(),
        visualization=LinkConfig(),
        mep=LinkConfig(),
        mixed_reality=LinkConfig(),
        tcp_port=None,
    )
    async with open_gateway(GatewayAdapter(dispatcher, cell, dispatcher.submit), config, clock, folder) as gateway:
        yield {"echo": echo.get_extra_info("sockname")[1], "planner": gateway.addresses["planner"][1]}
    await edge.close()
    await dispatcher.close()
    await journal.close()
    await bus.close()


async def serve(endpoint: str, folder: Path, durable: bool) -> None:
    """Run the server until standard input ends; print only the ports as one line of JSON.

    Args:
        endpoint: Zenoh endpoint of the bus.
        folder: Folder of the journal.
        durable: True to synchronise every commit.
    """
    log_to_stderr()
    keep_pauses_short()
    ended = asyncio.Event()
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), ended.set)
    async with running_server(endpoint, folder, durable) as ports:
        print(json.dumps(ports), flush=True)
        await ended.wait()


def measure_udp(port: int, datagrams: list[bytes]) -> list[float]:
    """Return the round-trip times of datagrams, µs.

    Args:
        port: Port of the server.
        datagrams: Datagrams to send.
    """
    times = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(2.0)
        client.connect(("127.0.0.1", port))
        for datagram in datagrams:
            begin = time.perf_counter_ns()
            client.send(datagram)
            client.recv(2048)
            times.append((time.perf_counter_ns() - begin) / 1000.0)
            time.sleep(PAUSE)
    return times


def measure_query(session: zenoh.Session, key: str, payloads: list[bytes]) -> list[float]:
    """Return the round-trip times of queries, µs.

    Args:
        session: Zenoh session.
        key: Key of the queries.
        payloads: Payloads to send.
    """
    times = []
    for payload in payloads:
        begin = time.perf_counter_ns()
        for reply in session.get(key, payload=payload, timeout=2.0):
            if reply.ok is None:
                raise SystemExit(f"{key}: {reply.err}")
        times.append((time.perf_counter_ns() - begin) / 1000.0)
        time.sleep(PAUSE)
    return times


def register_datagrams(count: int) -> list[bytes]:
    """Return commands that the workflow rejects, each with a different id."""
    return [format_command("start_registrati", client_id=str(10_000 + n)) for n in range(count)]


def measure_plans(port: int, count: int) -> list[float]:
    """Return the times from the second half of a plan to its verdict, µs: accepted, journalled, a state changed.

    Args:
        port: Port of the planner's link.
        count: Number of plans.
    """
    times = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(2.0)
        client.connect(("127.0.0.1", port))
        for n in range(count):
            client.send(format_command("target_rotxxxxxx", 0.0, 0.0, 0.0, 1.0, client_id=str(10**6 + 2 * n)))
            client.recv(2048)
            time.sleep(PAUSE)
            datagram = format_command("target_tslxxxxxx", 0.0, 0.05, 0.1, client_id=str(10**6 + 2 * n + 1))
            begin = time.perf_counter_ns()
            client.send(datagram)
            answer = client.recv(2048)
            times.append((time.perf_counter_ns() - begin) / 1000.0)
            if b"accepted" not in answer:
                raise SystemExit(f"not accepted: {answer!r}")
            time.sleep(PAUSE)
    return times


def measure_commit(folder: Path, count: int) -> list[float]:
    """Return the times of single SQLite commits with fsync, µs.

    Args:
        folder: Folder of the database.
        count: Number of commits.
    """
    connection = sqlite3.connect(folder / "commit.sqlite", isolation_level=None)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("CREATE TABLE t (body BLOB)")
    times = []
    for _ in range(count):
        begin = time.perf_counter_ns()
        connection.execute("INSERT INTO t VALUES (?)", (b"x" * 600,))
        times.append((time.perf_counter_ns() - begin) / 1000.0)
    connection.close()
    return times


@contextlib.contextmanager
def server(endpoint: str, folder: Path, durable: bool) -> Any:
    """Start the server process for the length of the context; yield its ports.

    Args:
        endpoint: Zenoh endpoint of the bus.
        folder: Folder of the journal.
        durable: True to synchronise every commit.
    """
    command = [sys.executable, __file__, "--serve", endpoint, str(folder), *(["--durable"] if durable else [])]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield json.loads(process.stdout.readline())  # type: ignore[union-attr]
    finally:
        process.stdin.close()  # type: ignore[union-attr]
        process.wait(timeout=20)


def spread(times: list[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum, µs.

    Args:
        times: Times, µs.
    """
    ordered = sorted(times)
    p99 = ordered[int(0.99 * (len(ordered) - 1))]
    return {"p50": round(median(ordered), 1), "p99": round(p99, 1), "max": round(ordered[-1], 1)}


ECHO, REJECTED, ACCEPTED = (
    "UDP, bare asyncio echo (uvloop)",
    "UDP command, rejected",
    "UDP command, accepted and committed",
)
QUERY, ACCEPTED_QUERY = "Zenoh, bare query answered in the loop", "Zenoh query, accepted and committed"
COMMIT = "one SQLite commit with fsync, alone"
BARE = {REJECTED: ECHO, ACCEPTED: ECHO, ACCEPTED_QUERY: QUERY}
"""Rows of the table, and the bare counterpart of each that has one."""


def compare(durable: bool, count: int, warm_up: int) -> dict[str, dict[str, float]]:
    """Return the times from each kind of command to its verdict, and of its bare counterpart, µs.

    Args:
        durable: True to synchronise every commit.
        count: Number of commands of each kind.
        warm_up: Number of commands before those.
    """
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    found = {}
    with tempfile.TemporaryDirectory(dir=os.environ.get("BENCHMARK_FOLDER")) as name:
        folder = Path(name)
        with server(endpoint, folder, durable) as ports:
            every = count + warm_up
            found[ECHO] = spread(measure_udp(ports["echo"], [b"x" * 30] * every)[warm_up:])
            found[REJECTED] = spread(measure_udp(ports["planner"], register_datagrams(every))[warm_up:])
            found[ACCEPTED] = spread(measure_plans(ports["planner"], every)[warm_up:])
            config = zenoh.Config()
            config.insert_json5("mode", '"client"')
            config.insert_json5("connect/endpoints", json.dumps([endpoint]))
            config.insert_json5("scouting/multicast/enabled", "false")
            with zenoh.open(config) as session:
                prefix = "pcmrs/lab/benchmark"
                found[QUERY] = spread(measure_query(session, f"{prefix}/svc/echo", [b"{}"] * every)[warm_up:])
                payloads = [msgspec.json.encode({"arguments": PLAN})] * every
                planned = measure_query(session, f"{prefix}/cmd/local/toolplan/plan", payloads)
                found[ACCEPTED_QUERY] = spread(planned[warm_up:])
            if durable:
                found[COMMIT] = spread(measure_commit(folder, count))
    return found


def show(kind: str, found: dict[str, dict[str, float]]) -> None:
    """Print the times as a table.

    Args:
        kind: ``with`` or ``without`` fsync.
        found: Times of each row, µs.
    """
    print(f"journal {kind} fsync: p50, p99, max in µs; ratio of p50 to the bare one")
    for name, times in found.items():
        ratio = times["p50"] / found[BARE.get(name, name)]["p50"]
        print(f"  {name:<44} {times['p50']:8.0f} {times['p99']:8.0f} {times['max']:8.0f} {ratio:6.2f}")
    if COMMIT in found:
        aim = found[ECHO]["p50"] + 2 * found[COMMIT]["p50"] + 150.0
        accepted = found[ACCEPTED]["p50"]
        print(f"  aim for an accepted command: echo + two flushes + 150 = {aim:.0f} µs, found {accepted:.0f} µs")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--warm-up", type=int, default=300, help="commands before those that count")
    parser.add_argument(
        "--fsync", choices=FSYNC, default="both", help="journal with fsync, without, or one after the other"
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--serve", nargs=2, metavar=("ENDPOINT", "FOLDER"), help=argparse.SUPPRESS)
    parser.add_argument("--durable", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        endpoint, folder = arguments.serve
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(serve(endpoint, Path(folder), arguments.durable))
        return
    found = {kind: compare(kind == "with", arguments.count, arguments.warm_up) for kind in FSYNC[arguments.fsync]}
    if arguments.json:
        print(json.dumps(found))
        return
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}, {arguments.count} commands each")
    for kind, times in found.items():
        show(kind, times)


if __name__ == "__main__":
    main()
