"""A daemon of an experiment's own: free ports, a folder that goes away, nobody else on it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from pcmrs.bus import Bus, BusSettings
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.errors import CommandRefusedError
from pcmrs.journal import JournalReader
from pcmrs.planner import Planner
from pcmrs.testing.daemon import own_settings, running_daemon
from pcmrs.threads import Load, Threads


@dataclass(frozen=True, slots=True)
class ExperimentBench:
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
async def private_bench(overrides: Sequence[str]) -> AsyncIterator[ExperimentBench]:
    """Starts a daemon, waits until it is ready, and ends it with the context.

    Args:
        overrides: Settings of the daemon, ``key=value`` each.

    Raises:
        DeviceError: It did not start; the text has its last words.
    """
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as folder:
        cell = f"experiment-{os.getpid()}"
        settings = [*own_settings(Path(folder), cell), *overrides]
        async with running_daemon(settings, Path(folder) / "log") as daemon, AsyncExitStack() as stack:
            ready = daemon.ready
            bus = await Bus.open(BusSettings(endpoint=ready.endpoint, cell=cell))
            stack.push_async_callback(bus.close)
            bench = ExperimentBench(
                planner=await stack.enter_async_context(await Planner.open(*ready.links["planner"])),
                client=await stack.enter_async_context(Client.connect(ready.endpoint, cell=cell)),
                scene=RemoteScene(bus, SystemClock()),
                journal=stack.enter_context(JournalReader(Path(ready.journal))),
            )
            try:
                yield bench
            except CommandRefusedError as error:
                raise explained(error, bench.journal, Threads().load()) from None


def explained(error: CommandRefusedError, journal: JournalReader, load: Load) -> CommandRefusedError:
    """The refusal with the danger that was reported last, and with what the machine has to do where that is too much.

    Args:
        error: Its text has the code of the reason only, as the string commands give it.
        journal: Of the daemon.
        load: Of the machine.
    """
    text = error.text
    reported = [stored.row.result or {} for stored in journal.read(kind="device")]
    dangers = [result["text"] for result in reported if result.get("danger")]
    if dangers:
        text += f" {dangers[-1]}"
    if load.running > load.processors:
        text += f" The machine is overloaded: {load}."
    return CommandRefusedError(text, **error.fields)
