"""A daemon as a user runs it: a process of its own, on free ports, in a cell and a folder that nobody else has."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import msgspec
import zenoh

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.seal import Seal
from pcmrs.client import Client
from pcmrs.planner import Planner
from pcmrs.service import Ready
from pcmrs.testing.cell import QUICK
from pcmrs.testing.daemon import DEVICE_KEY, command_line, device_key, free_port
from pcmrs.testing.driving import connect, reset_cell, to_retracted, wait_until_stationary
from pcmrs.threads import descendants
from tests import ROOT

PLAN: dict[str, Any] = json.loads((ROOT / "examples" / "ratms_plan.json").read_text())
LOOK, DRIFT = 0.25, 1e-3
"""An arm that stands moves by less than so many rad in so many seconds; in the slowest motion it moves by more."""
START_TIME = 60.0
"""Seconds in which a daemon is ready on a machine that does much else."""
PATIENCE = 20.0
"""Seconds that anything may take before a test gives up."""

SLOW = ("procedure.motion.linear_velocity=0.03",)
"""Settings under which every motion lasts for seconds of the machine, so that a test can act in the middle of it."""


class ServeProcess:
    """A running `pcmrs-serve`.

    Attributes:
        ready: What it said about itself when it was ready.
        settings: How it was started.
    """

    def __init__(self, process: subprocess.Popen[bytes], ready: Ready, settings: Sequence[str], folder: Path) -> None:
        self.process = process
        self.ready = ready
        self.settings = list(settings)
        self._folder = folder
        self._forgotten = 0

    @property
    def log(self) -> str:
        """Everything that daemon and node have written to standard error since `forget_log`."""
        return self._written()[self._forgotten :].decode(errors="replace")

    def forget_log(self) -> None:
        """Leaves out of `log` what was written before: a test that shares the daemon must not find it there."""
        self._forgotten = len(self._written())

    def _written(self) -> bytes:
        return (self._folder / "log").read_bytes()

    @property
    def cell(self) -> str:
        return self.ready.prefix.split("/")[-1]

    def planner(self) -> AbstractAsyncContextManager[Planner]:
        """A planner of the daemon."""
        return _opened(self.ready.links["planner"])

    def client(self) -> AbstractAsyncContextManager[Client]:
        """A client on the daemon's bus."""
        return Client.connect(self.ready.endpoint, "test", self.cell, device_key=self._device_key)

    @contextmanager
    def plain_session(self) -> Iterator[zenoh.Session]:
        """A Zenoh session that knows nothing of PCMRS, as a command-line tool has."""
        config = zenoh.Config()
        values = {"mode": "client", "connect/endpoints": [self.ready.endpoint], "scouting/multicast/enabled": False}
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
        with zenoh.open(config) as session:
            yield session

    @property
    def _device_key(self) -> bytes:
        return device_key(Path(self.ready.folder))

    @asynccontextmanager
    async def bus(self) -> AsyncIterator[Bus]:
        """The bus as a device node or a console has it."""
        settings = BusSettings(endpoint=self.ready.endpoint, site="test", cell=self.cell)
        bus = await Bus.open(settings, Seal(self._device_key))
        try:
            yield bus
        finally:
            await bus.close()

    def reply_port(self, link: str) -> int:
        """The port at which an unmodified client of a link listens."""
        (setting,) = (setting for setting in self.settings if setting.startswith(f"gateway.{link}="))
        return int(setting.removesuffix("}").rpartition("=")[2])

    def pcmrs(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Runs ``pcmrs`` on this daemon's cell."""
        address = ("--endpoint", self.ready.endpoint, "--site", "test", "--cell", self.cell)
        return run_pcmrs(words[0], *address, *words[1:])

    def children(self) -> list[int]:
        """Ids of the daemon's children but heart and planner: the nodes, and recorder and console if they run."""
        return _running(self.process.pid, "pcmrs.cli")

    def heart(self) -> int:
        """Id of the process that sends the daemon's heartbeats."""
        (found,) = _running(self.process.pid, "pcmrs.bus.heart")
        return found

    def fork_server(self) -> int:
        """Id of the process that starts the daemon's children."""
        (found,) = _running(self.process.pid, "pcmrs.processes.forked")
        return found

    def world_of(self, node: int) -> int:
        """Id of the process in which the devices of a node are simulated."""
        (found,) = _running(node, "pcmrs_sim.process.world")
        return found

    def end(self, number: int = signal.SIGTERM) -> int:
        """Sends a signal and returns the exit status."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE)


def run_pcmrs(*words: str) -> subprocess.CompletedProcess[str]:
    """Runs ``pcmrs`` with the words as arguments."""
    command = [sys.executable, "-m", "pcmrs.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=START_TIME, check=False)


def own_settings(folder: Path) -> list[str]:
    """Settings of a cell that nobody else has; port 0 takes a free one."""
    device_key(folder)
    return [
        "cell.site=test",
        f"access.device_key={folder / DEVICE_KEY}",
        f"cell.name=c{uuid.uuid4().hex[:8]}",
        f"cell.endpoint=tcp/127.0.0.1:{free_port()}",
        f"cell.folder={folder}",
        *(f"gateway.{link}={{port=0,reply_port={free_port()}}}" for link in ("planner", "robot", "visualization")),
        "gateway.mixed_reality={}",
        "gateway.mep={port=0}",
        "gateway.tcp_port=0",
        "recording.enabled=false",
        "console.enabled=false",
        *QUICK,
    ]


def virtual_drivers() -> list[str]:
    """Settings by which robot and tracker are driven as real ones are; the simulated cell serves virtual ones."""
    cabinet, tracker = free_port(), free_port()
    return [
        "cell.rate=1",
        "robot.driver=kst",
        f"kst.port={cabinet}",
        "tracker.driver=ndi",
        f"ndi.device=127.0.0.1:{tracker}",
    ]


def as_words(settings: Sequence[str]) -> list[str]:
    """The settings as words of a command line."""
    return [word for setting in settings for word in ("--set", setting)]


@contextmanager
def running_daemon(settings: Sequence[str], folder: Path) -> Iterator[ServeProcess]:
    """Starts a daemon, waits until it is ready, and ends it with the context, whatever state it is in."""
    with (folder / "log").open("ab") as log:
        command = [sys.executable, "-m", "pcmrs.cli", "serve", "--json", *as_words(settings)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log)
    nodes: list[int] = []
    try:
        assert process.stdout is not None
        line = first_line(process.stdout)
        assert line, f"the daemon did not start: {(folder / 'log').read_text()}"
        nodes = descendants(process.pid)
        yield ServeProcess(process, msgspec.json.decode(line, type=Ready), settings, folder)
    finally:
        if process.poll() is None:
            for pid in (process.pid, *descendants(process.pid)):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
            process.terminate()
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for node in filter(is_running, nodes):
            os.kill(node, signal.SIGKILL)
        if process.stdout is not None:
            process.stdout.close()


async def start_over(daemon: ServeProcess) -> None:
    """Brings a shared cell to its initial state, whatever a test has done to its processes, and forgets the log."""
    async with daemon.client() as client:
        if (await client.state()).branches["robot"] == "0":
            await connect(client)  # its node may be starting
        await reset_cell(client)
        assert not (await client.state()).latched
    daemon.forget_log()


async def register_again(daemon: ServeProcess) -> None:
    """Brings a shared cell to a registered head and a retracted tool, as far as it is not, and forgets the log."""
    async with daemon.client() as client:
        await wait_until_stationary(client)
        await to_retracted(client)
        assert not (await client.state()).latched
    daemon.forget_log()


async def stands_still(client: Client) -> bool:
    """Whether the robot itself, asked past the daemon, is twice found where it was."""
    before = await client.request_device("robot", "joints")
    await asyncio.sleep(LOOK)
    after = await client.request_device("robot", "joints")
    moved = (abs(there - here) for there, here in zip(after["positions"], before["positions"], strict=True))
    return bool(max(moved) < DRIFT and after["captured"] > before["captured"])


def is_running(pid: int) -> bool:
    """Whether there is such a process, and it has not ended yet."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def wait_until(condition: Callable[[], bool], within: float = PATIENCE) -> bool:
    """Whether a condition came true in time; for what only the operating system can tell."""
    end = time.monotonic() + within
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


@asynccontextmanager
async def _opened(address: tuple[str, int]) -> AsyncIterator[Planner]:
    async with await Planner.open(*address) as planner:
        yield planner


def _running(pid: int, module: str) -> list[int]:
    """Ids of the processes below a process that run a module."""
    return [each for each in descendants(pid) if module in command_line(each)]


def first_line(stream: IO[bytes]) -> bytes:
    """The line with which a process says that it is ready; empty when it does not in time."""
    os.set_blocking(stream.fileno(), False)
    read = b""

    def complete() -> bool:
        nonlocal read
        read += stream.read() or b""
        return read.endswith(b"\n")

    return read if wait_until(complete, START_TIME) else b""
