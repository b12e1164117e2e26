"""A daemon of an experiment's own: free ports, a folder that goes away, nobody else on it."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pcmrs.bus import Bus, BusSettings
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.errors import DeviceError
from pcmrs.journal import JournalReader
from pcmrs.planner import Planner
from pcmrs.service import Ready

START_TIME = 60.0
"""The daemon must say that it is ready within this, s."""

END_TIME = 15.0


@dataclass(frozen=True, slots=True)
class Bench:
    """What an experiment works with.

    Attributes:
        planner: Sends the commands that string commands have, over UDP.
        client: Sends the others, over the bus.
        scene: Ground truth and faults of the simulation, for the report only.
        journal: What the daemon decided.
    """

    planner: Planner
    client: Client
    scene: RemoteScene
    journal: JournalReader


@asynccontextmanager
async def private_bench(overrides: Sequence[str]) -> AsyncIterator[Bench]:
    """Starts a daemon, waits until it is ready, and ends it with the context.

    Args:
        overrides: Settings of the daemon, ``key=value`` each.

    Raises:
        DeviceError: It did not start; the text has its last words.
    """
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as folder:
        cell = f"experiment-{os.getpid()}"
        own = [f"cell.name={cell}", f"cell.folder={folder}", f"cell.endpoint=tcp/127.0.0.1:{_free_port()}"]
        links = [f"gateway.{link}.port=0" for link in ("planner", "robot", "visualization", "mep")]
        # Where virtual devices are served, if a driver looks for them.
        virtual = [f"kst.port={_free_port()}", f"ndi.device=127.0.0.1:{_free_port()}"]
        settings = [*own, *links, "gateway.tcp_port=0", *virtual, *overrides]
        async with _daemon(settings, Path(folder) / "log") as ready, AsyncExitStack() as stack:
            bus = await Bus.open(BusSettings(endpoint=ready.endpoint, cell=cell))
            stack.push_async_callback(bus.close)
            yield Bench(
                planner=await stack.enter_async_context(await Planner.open(*ready.links["planner"])),
                client=await stack.enter_async_context(Client.connect(ready.endpoint, cell=cell)),
                scene=RemoteScene(bus, SystemClock()),
                journal=stack.enter_context(JournalReader(Path(ready.journal))),
            )


@asynccontextmanager
async def _daemon(overrides: Sequence[str], log: Path) -> AsyncIterator[Ready]:
    settings = [word for override in overrides for word in ("--set", override)]
    with log.open("wb") as errors:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "pcmrs.cli",
            "serve",
            "--json",
            *settings,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
        )
    try:
        yield await _ready(process, log)
    finally:
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(END_TIME):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()


async def _ready(process: asyncio.subprocess.Process, log: Path) -> Ready:
    line = b""
    if process.stdout is not None:
        with suppress(TimeoutError):
            async with asyncio.timeout(START_TIME):
                line = await process.stdout.readline()
    try:
        return msgspec.json.decode(line, type=Ready)
    except msgspec.MsgspecError:
        raise DeviceError(f"The daemon did not start: {_last_words(log)}") from None


def _last_words(log: Path) -> str:
    return " ".join(log.read_text(errors="replace").splitlines()[-3:])


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
