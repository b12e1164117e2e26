"""Separate daemon of an experiment: free ports, a temporary folder, no other clients."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
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
    """Connections of an experiment to its daemon.

    Attributes:
        planner: Sends the commands that have string commands, over UDP.
        client: Sends the other commands, over the bus.
        scene: Ground truth and faults of the simulation, for the report only.
        journal: Journal of the daemon.
    """

    planner: Planner
    client: Client
    scene: RemoteScene
    journal: JournalReader


@asynccontextmanager
async def private_bench(overrides: Sequence[str]) -> AsyncIterator[ExperimentBench]:
    """Start a daemon, wait until it is ready, and end it at the end of the context.

    If a command is refused, the folder of the cell stays, and the text of the error has its name.

    Args:
        overrides: Settings of the daemon, ``key=value`` each.

    Raises:
        CommandRefusedError: A command of the experiment was refused; see `explained`.
        DeviceError: The daemon did not start; the text has the end of its log.
    """
    with ExitStack() as cleaning:
        folder = Path(tempfile.mkdtemp(prefix="pcmrs-"))
        cleaning.callback(shutil.rmtree, folder)
        cell = f"experiment-{os.getpid()}"
        settings = [*own_settings(folder, cell), *overrides]
        async with running_daemon(settings, folder / "log") as daemon, AsyncExitStack() as stack:
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
                cleaning.pop_all()
                raise explained(error, bench.journal, Threads().load()) from None


def explained(error: CommandRefusedError, journal: JournalReader, load: Load) -> CommandRefusedError:
    """Return the refusal with the text of the last danger event, the load if it is too high, and the journal's file.

    Args:
        error: Refusal, whose text has only the code of the reason, as string commands give it.
        journal: Journal of the daemon.
        load: Load of the machine.

    Returns:
        Refusal with the additional text.
    """
    text = error.text
    reported = [stored.row.result or {} for stored in journal.read(kind="device")]
    dangers = [result["text"] for result in reported if result.get("danger")]
    if dangers:
        text += f" {dangers[-1]}"
    if load.is_too_high:
        text += f" The machine is overloaded: {load}."
    text += f" The journal was kept: {journal.path}."
    return CommandRefusedError(text, **error.fields)
