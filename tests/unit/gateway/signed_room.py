"""An open gateway with peers that sign, and what they send from."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

from pcmrs.gateway.links import Gateway, open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig, PeerConfig
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.messages import DeviceEvent
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.gateway.gateway_fakes import WITHIN, FakeCore, UdpClient

EVERYTHING = ("read", "stream", "record", "plan", "digitize", "register", "robot", "motion")


def peer(folder: Path, name: str, **limits: Any) -> PeerConfig:
    """A peer with a key of its own, made when it is first asked for; it may do everything unless told."""
    file = folder / f"{name}.key"
    if not file.exists():
        new_key(file)
    return PeerConfig(key_file=str(file), **{"allow": EVERYTHING, **limits})


def signer(folder: Path, name: str, first: int = 1) -> Signer:
    """Signs with counters from `first` on."""
    return Signer(name, read_key(folder / f"{name}.key"), count(first).__next__)


def config(
    peers: dict[str, PeerConfig],
    host: str = "127.0.0.1",
    reply_port: int | None = None,
    stream_port: int | None = None,
    surgeon: str = "",
) -> GatewayConfig:
    return GatewayConfig(
        host=host,
        surgeon=surgeon,
        planner=LinkConfig(port=0, reply_port=reply_port, stream_port=stream_port),
        robot=LinkConfig(),
        visualization=LinkConfig(),
        mep=LinkConfig(port=0),
        tcp_port=0,
        peers=peers,
    )


@dataclass
class Room:
    """The gateway, bound to every address, so that it takes nothing unsigned."""

    core: FakeCore
    clock: ManualClock
    gateway: Gateway
    client: UdpClient
    replies: UdpClient
    folder: Path
    signers: dict[str, Signer] = field(default_factory=dict)

    @property
    def planner(self) -> tuple[str, int]:
        return "127.0.0.1", self.gateway.addresses["planner"][1]

    @property
    def tcp(self) -> tuple[str, int]:
        return "127.0.0.1", self.gateway.addresses["tcp"][1]

    def sign(self, command: str, name: str = "planner") -> bytes:
        if name not in self.signers:
            self.signers[name] = signer(self.folder, name)
        return self.signers[name].sign(command.encode())

    async def ask(self, command: str, name: str = "planner") -> str:
        """The verdict reply to a signed command, or whatever else came."""
        self.client.send(self.sign(command, name), self.planner)
        return await self.client.received.get()

    async def hear(self, data: bytes) -> None:
        """Sends a datagram and returns once the gateway has it."""
        before = self.gateway.counters.received
        self.client.send(data, self.planner)
        async with asyncio.timeout(WITHIN):
            while self.gateway.counters.received == before:
                await settle()

    @property
    def unanswered(self) -> bool:
        return self.client.received.empty() and self.replies.received.empty()


@asynccontextmanager
async def open_room(
    folder: Path, peers: dict[str, PeerConfig], host: str = "0.0.0.0", *, stream: bool = False, surgeon: str = ""
) -> AsyncIterator[Room]:
    """With `stream`, the client also gets what is sent to the planner's stream port."""
    client, replies = await UdpClient.open(), await UdpClient.open()
    core, clock = FakeCore(), ManualClock()
    async with open_gateway(
        core, config(peers, host, replies.port, client.port if stream else None, surgeon), clock, folder
    ) as gateway:
        yield Room(core, clock, gateway, client, replies, folder)
        core.open_gates()
    client.transport.close()
    replies.transport.close()


def told(room: Room) -> set[str]:
    return {event.fields["reason"] for event in refused(room)}


def refused(room: Room) -> list[DeviceEvent]:
    return [event for event in room.core.events if event.code == "refused"]
