"""An open gateway before a fake daemon, and a client with its sockets."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcmrs.gateway.links import Gateway, open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from tests.unit.gateway.gateway_fakes import FakeCore, ManualClock, UdpClient


@dataclass
class Cell:
    """A gateway on free ports before a fake daemon, and a client with its reply and stream sockets."""

    core: FakeCore
    clock: ManualClock
    gateway: Gateway
    client: UdpClient
    replies: UdpClient
    stream: UdpClient
    folder: Path
    config: GatewayConfig

    @property
    def planner(self) -> tuple[str, int]:
        return self.gateway.addresses["planner"]

    @property
    def robot(self) -> tuple[str, int]:
        return self.gateway.addresses["robot"]

    @property
    def mep(self) -> tuple[str, int]:
        return self.gateway.addresses["mep"]

    async def tell(self, command: str, address: tuple[str, int] | None = None) -> str:
        """Sends a command that is acknowledged; returns what came to the reply port."""
        self.client.send(command, address or self.planner)
        return await self.replies.received.get()

    async def ask(self, command: str, address: tuple[str, int] | None = None) -> str:
        """Sends a command with an id; returns its verdict reply."""
        return await self.client.ask(command, address or self.planner)


@asynccontextmanager
async def open_cell(folder: Path, surgeon: str = "") -> AsyncIterator[Cell]:
    client, replies, stream = await UdpClient.open(), await UdpClient.open(), await UdpClient.open()
    config = GatewayConfig(
        surgeon=surgeon,
        planner=LinkConfig(port=0, reply_port=replies.port, stream_port=stream.port),
        robot=LinkConfig(port=0, reply_port=replies.port),
        visualization=LinkConfig(port=0, reply_port=replies.port, stream_port=stream.port),
        mixed_reality=LinkConfig(),
        mep=LinkConfig(port=0),
        tcp_port=0,
    )
    core, clock = FakeCore(), ManualClock()
    async with open_gateway(core, config, clock, folder) as gateway:
        yield Cell(core, clock, gateway, client, replies, stream, folder, config)
        core.open_gates()
    for socket in (client, replies, stream):
        socket.transport.close()


async def hear_from_others(cell: Any, many: int) -> None:
    for _ in range(many):
        other = await UdpClient.open()
        await other.ask("get_jnt_angsxxxx_#1;", cell.planner)
        other.transport.close()


async def pass_barrier(cell: Any, address: tuple[str, int] | None = None) -> None:
    """Returns once everything sent to that link before has been received: datagrams of one socket stay in order."""
    barrier = next(BARRIERS)
    assert (await cell.ask(f"get_jnt_angsxxxx_#{barrier};", address)).startswith(f"{barrier}_accepted")


BARRIERS = iter(range(900_000, 999_999))
