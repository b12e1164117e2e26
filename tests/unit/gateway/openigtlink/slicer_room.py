"""A gateway with an OpenIGTLink server, and a Slicer."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.clock import SystemClock
from pcmrs.gateway.links import Gateway, open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig, OpenIgtLinkConfig
from tests.unit.gateway.igtl_client import Slicer, SlicerCore, slicer_only

TARGET = "ToolTargetToImage"


LANDMARKS_MM = [(80.0, 10.0, 0.0), (-80.0, 10.0, 0.0), (0.0, 95.5, -20.0)]


LINE = "registration 000, digitization 0, toolplan 0, robot 1, placement retracted"


FACES = ["left", "", "nasion"]


@dataclass
class Room:
    """A gateway with an OpenIGTLink server and a robot link, before a fake daemon, and a Slicer."""

    core: SlicerCore
    gateway: Gateway
    slicer: Slicer

    @property
    def address(self) -> tuple[str, int]:
        return self.gateway.addresses["openigtlink"]


def config(**values: Any) -> GatewayConfig:
    table = msgspec.convert({"enabled": True, "port": 0, "rate_hz": 200.0} | values, OpenIgtLinkConfig)
    return slicer_only(table, robot=LinkConfig(port=0))


@asynccontextmanager
async def opened(folder: Path, **values: Any) -> AsyncIterator[Room]:
    core = SlicerCore()
    async with open_gateway(core, config(**values), SystemClock(), folder) as gateway:
        room = Room(core, gateway, await Slicer.connect(gateway.addresses["openigtlink"]))
        yield room
        room.slicer.close()
        core.open_gates()
