"""A small daemon on a real bus, and a client of it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from pcmrs.bus import Bus, CommandEdge, Empty
from pcmrs.client import Client
from pcmrs.messages import Command, Snapshot, Verdict
from tests.unit.bus.bus_cells import accepted, new_cell, open_bus, snapshot


class Daemon:
    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.commands: list[Command] = []
        self.stops: list[str] = []
        self.snapshots = 0
        bus.serve("svc/snapshot", Empty, self.snapshot)

    async def submit(self, command: Command, *, arrived: float) -> Verdict:
        self.commands.append(command)
        verdict = accepted(command)
        self.bus.publish("state/event", verdict)
        return verdict

    def stop(self, source: str, _presses: int) -> int:
        """Numbers each Stop, from 1."""
        self.stops.append(source)
        return len(self.stops)

    async def snapshot(self, _: str, __: Empty) -> Snapshot:
        self.snapshots += 1
        return snapshot(len(self.commands))


@asynccontextmanager
async def connected() -> AsyncIterator[tuple[Daemon, Client]]:
    async with open_bus(new_cell()) as bus:
        daemon = Daemon(bus)
        edge = await CommandEdge.open(bus, daemon.submit, lambda *_: None, daemon.stop)
        try:
            settings = bus.settings
            async with Client.connect(settings.endpoint, settings.site, settings.cell, user="anna") as client:
                yield daemon, client
        finally:
            await edge.close()
