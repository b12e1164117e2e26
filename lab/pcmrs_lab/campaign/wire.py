"""A cell whose device node is one of another machine, behind a wire that can be spoilt."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from pcmrs.errors import PcmrsError
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.daemon import DEVICE_KEY, device_key, free_port
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.network_impairment import NetworkImpairment
from pcmrs_lab.campaign.outside import WITHOUT_NODES, outside_node
from pcmrs_lab.campaign.proxy import tcp_proxy


@asynccontextmanager
async def remote_cell(lab: Lab, weather: NetworkImpairment) -> AsyncIterator[RunningCell]:
    """A cell whose device node is one of another machine, as far as the wire between them goes."""
    port = free_port()
    place = lab.folder / "remote"
    place.mkdir()
    async with tcp_proxy(("127.0.0.1", port), weather) as (host, proxied):
        near = f"cell.endpoint=tcp/127.0.0.1:{port}"
        device_key(place)
        far = (
            f"cell.name={place.name}",
            f"cell.endpoint=tcp/{host}:{proxied}",
            f"access.device_key={place / DEVICE_KEY}",
            "cell.rate=1",
            "robot.deadman=0.5",  # as the daemon's: a busy machine is no partition
            f"sim.seed={lab.seed}",
        )
        starting = asyncio.create_task(_node_when_router(port, far, place / "node.log"))
        try:
            settings = (near, "cell.rate=1", "procedure.max_pose_age=0.5", *WITHOUT_NODES)
            async with lab.daemon(*settings, folder=place) as cell:
                yield cell
        finally:
            weather.rate, weather.towards, weather.back = None, True, True
            starting.cancel()
            with suppress(asyncio.CancelledError, PcmrsError):
                await starting


async def _node_when_router(port: int, settings: Sequence[str], log: Path) -> None:
    """Starts the node once the daemon's router listens, and ends it when cancelled."""
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.1)
            continue
        writer.close()
        break
    async with outside_node(settings, log) as node:
        await node.wait()
