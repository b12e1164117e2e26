"""A small daemon on a real bus, and a client of it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgspec

from pcmrs.bus import Bus, CommandEdge, Empty
from pcmrs.client import Client
from pcmrs.messages import Command, NextStep, NextStepRequest, Snapshot, StageShown, Verdict
from tests.unit.bus.bus_cells import accepted, new_cell, open_bus, snapshot


class Daemon:
    """Accepts everything; its snapshot has the values of `shown`."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.commands: list[Command] = []
        self.stops: list[str] = []
        self.snapshots = 0
        self.shown: dict[str, Any] = {}
        bus.serve("svc/snapshot", Empty, self.snapshot)
        bus.serve("svc/next", NextStepRequest, self.next_step)

    async def submit(self, command: Command, *, arrived: float | None) -> Verdict:
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
        return msgspec.structs.replace(snapshot(len(self.commands)), **self.shown)

    async def next_step(self, _: str, question: NextStepRequest) -> NextStep:
        """The operation that is asked about; in no question, that the stage is reached."""
        stages = [StageShown(id="plan", title="Plan it", reached=not question.operation)]
        return NextStep(next=question.operation, why="So it is.", path=[question.operation], stages=stages)


@asynccontextmanager
async def connected(user: str = "anna") -> AsyncIterator[tuple[Daemon, Client]]:
    async with open_bus(new_cell()) as bus:
        daemon = Daemon(bus)
        edge = await CommandEdge.open(bus, daemon.submit, lambda *_: None, daemon.stop)
        try:
            settings = bus.settings
            async with Client.connect(settings.endpoint, settings.site, settings.cell, user=user) as client:
                yield daemon, client
        finally:
            await edge.close()
