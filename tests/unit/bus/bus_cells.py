"""Cells of their own for tests: a free port, a router and clients."""

from __future__ import annotations

import json
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

import msgspec
import zenoh

from pcmrs.bus import Bus, BusSettings, Empty
from pcmrs.bus.seal import Seal
from pcmrs.messages import BlueprintTag, BodyPose, Command, Snapshot, Verdict
from pcmrs.testing.daemon import free_port

TIMEOUT = 20.0


def new_cell() -> BusSettings:
    """Router settings of a cell that nobody else has."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    return BusSettings(mode="router", endpoint=endpoint, site="test", cell=f"c{uuid.uuid4().hex[:8]}")


@asynccontextmanager
async def open_bus(settings: BusSettings, seal: Seal | None = None) -> AsyncIterator[Bus]:
    bus = await Bus.open(settings, seal)
    try:
        yield bus
    finally:
        await bus.close()


@asynccontextmanager
async def open_pair() -> AsyncIterator[tuple[Bus, Bus]]:
    """A router and a client of one cell."""
    settings = new_cell()
    async with open_bus(settings) as router, open_bus(msgspec.structs.replace(settings, mode="client")) as client:
        yield router, client


@contextmanager
def plain_session(settings: BusSettings) -> Iterator[zenoh.Session]:
    """A Zenoh client that knows nothing of PCMRS, as a command-line tool is."""
    config = zenoh.Config()
    for key, value in {"mode": "client", "connect/endpoints": [settings.endpoint]}.items():
        config.insert_json5(key, json.dumps(value))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


def accepted(command: Command) -> Verdict:
    return Verdict(
        id=command.id,
        branch=command.branch,
        operation=command.operation,
        decision="accepted",
        state="100",
        sequence=7,
        result={"source": command.source, "arguments": command.arguments},
    )


def snapshot(sequence: int) -> Snapshot:
    return Snapshot(
        sequence=sequence,
        branches={"registration": "000"},
        flags={},
        running=[],
        latched=False,
        blueprint=BlueprintTag(id="test", version="1", hash="0"),
    )


def pose(frame_number: int) -> BodyPose:
    return BodyPose(body="coil", frame_number=frame_number, captured=0.0, sent=0.0, valid=True)


async def sync(router: Bus, client: Bus) -> None:
    async def pong(_: str, __: Empty) -> Empty:
        return Empty()

    router.serve("svc/ping", Empty, pong)
    await client.request("svc/ping", Empty(), Empty, TIMEOUT)
