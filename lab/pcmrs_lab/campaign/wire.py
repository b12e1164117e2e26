"""Cell whose device node is on another machine, behind a link that can be impaired."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from pcmrs.errors import PcmrsError
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.daemon import DEVICE_KEY, SIMULATED_TOOL, device_key, free_port
from pcmrs.testing.proxy import tcp_proxy
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.outside import WITHOUT_NODES, outside_node


@asynccontextmanager
async def remote_cell(lab: Lab, impairment: InjectedImpairment) -> AsyncIterator[RunningCell]:
    """Start a cell whose device node reaches it over an impaired link, as if on another machine.

    Args:
        lab: Surroundings of the fault.
        impairment: Behaviour of the link.
    """
    port = free_port()
    place = lab.folder / "remote"
    place.mkdir()
    async with tcp_proxy(("127.0.0.1", port), impairment) as (host, proxied):
        near = f"cell.endpoint=tcp/127.0.0.1:{port}"
        device_key(place)
        far = (
            f"cell.name={place.name}",
            f"cell.endpoint=tcp/{host}:{proxied}",
            f"access.device_key={place / DEVICE_KEY}",
            "cell.rate=1",
            "robot.deadman=0.5",  # as in the daemon, so that a busy machine does not look like a partition
            f"sim.seed={lab.seed}",
        )
        starting = asyncio.create_task(_node_when_router(port, far, place / "node.log"))
        try:
            settings = (near, "cell.rate=1", "procedure.max_pose_age=0.5", *WITHOUT_NODES, *SIMULATED_TOOL)
            async with lab.daemon(*settings, folder=place) as cell:
                yield cell
        finally:
            impairment.rate, impairment.towards, impairment.back = None, True, True
            starting.cancel()
            with suppress(asyncio.CancelledError, PcmrsError):
                await starting


async def _node_when_router(port: int, settings: Sequence[str], log: Path) -> None:
    """Start the node once the daemon's router listens, and end it when cancelled."""
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
