"""A Slicer on one socket, for the tests of the OpenIGTLink link."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from pcmrs.devices.plus.frames import MessageReader
from pcmrs.gateway.settings import GatewayConfig, LinkConfig, OpenIgtLinkConfig
from pcmrs.messages import BlueprintTag, Running, Snapshot
from pcmrs.spatial import Transform
from tests.unit.gateway.gateway_fakes import POSE, WITHIN, FakeCore

KINDS = ("TRANSFORM", "POINT", "STRING", "STATUS", "TDATA")
BODY_REF_FROM_IMAGE = Transform.from_rotvec([0.02, -0.01, 0.05], [0.1, 0.2, 0.3])
SEEN = {
    "coil": Transform.from_rotvec([0.1, 0.2, 1.5], [0.3, 0.0, 0.1]),
    "pointer": Transform.from_rotvec([0.2, 0.1, 1.4], [0.0, 0.5, 0.1]),
    "body_ref": Transform.from_rotvec([-0.1, 0.1, 1.6], [0.2, 0.1, -0.4]),
}


def slicer_only(table: OpenIgtLinkConfig, robot: LinkConfig | None = None, host: str = "127.0.0.1") -> GatewayConfig:
    """A gateway with OpenIGTLink, and a robot link if that is given."""
    off = LinkConfig()
    return GatewayConfig(
        host=host, planner=off, robot=robot or off, visualization=off, mixed_reality=off, mep=off, tcp_port=None,
        openigtlink=table,
    )  # fmt: skip


class SlicerCore(FakeCore):
    """A fake daemon whose tracker, registration and latch the test sets."""

    def __init__(self) -> None:
        super().__init__()
        self.bodies: Mapping[str, Transform] = SEEN
        self.registered: Transform | None = BODY_REF_FROM_IMAGE
        self.pose: Transform | None = POSE
        self.latched = False
        self.running: list[Running] = []

    def seen(self) -> dict[str, Transform]:
        return dict(self.bodies)

    def registration(self) -> Transform | None:
        return self.registered

    def snapshot(self) -> Snapshot:
        return Snapshot(
            sequence=7,
            branches=dict(self.branches),
            flags={},
            running=self.running,
            latched=self.latched,
            blueprint=BlueprintTag(id="t", version="1", hash=""),
        )


class Slicer:
    """Keeps the connection, and of each name what came and was not asked for yet."""

    def __init__(self, stream: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.stream = stream
        self.writer = writer
        self._reader = MessageReader(stream, KINDS)
        self._kept: dict[str, deque[Any]] = {}

    @classmethod
    async def connect(cls, address: tuple[str, int]) -> Self:
        return cls(*await asyncio.open_connection(*address))

    def send(self, data: bytes) -> None:
        self.writer.write(data)

    async def next(self, name: str) -> Any:
        """The next message of that name; fails when none comes, though others do."""
        async with asyncio.timeout(WITHIN):
            while not self._kept.get(name):
                message: Any = await self._reader.read()
                self._kept.setdefault(message.device_name, deque(maxlen=1000)).append(message)
        return self._kept[name].popleft()

    async def verdict(self) -> str:
        return str((await self.next("PcmrsVerdict")).string)

    async def names(self, count: int) -> set[str]:
        """The names of the next `count` messages."""
        async with asyncio.timeout(WITHIN):
            messages: list[Any] = [await self._reader.read() for _ in range(count)]
        return {message.device_name for message in messages}

    async def status(self, code: int) -> Any:
        """The next status of that code; fails when none comes, though others do."""
        async with asyncio.timeout(WITHIN):
            while (status := await self.next("PcmrsStatus")).code != code:
                pass
        return status

    def close(self) -> None:
        self.writer.close()


def planned_mm(position_mm: tuple[float, float, float] = (40.0, 60.0, 80.0)) -> Any:
    """A target as Slicer has it: rigid, mm, turned about z by 90 degrees."""
    matrix = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    matrix[:3, 3] = position_mm
    return matrix
