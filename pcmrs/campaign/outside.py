"""Device nodes that no daemon starts, as those of another machine: they outlive it, and reach it by any address."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from pcmrs.service.children import end_child

DEVICES = ("robot", "tracker", "pointer", "scene")
WITHOUT_NODES = tuple(f"{device}.driver=none" for device in (*DEVICES, "stimulator", "emg"))
"""Settings of a daemon that starts no nodes itself."""

END_TIME = 5.0


@asynccontextmanager
async def outside_node(settings: Sequence[str], log: Path) -> AsyncIterator[asyncio.subprocess.Process]:
    """A node of the simulated devices for the length of the context; it keeps trying to reach its bus.

    Args:
        settings: Those of its daemon, but with ``cell.endpoint`` where this node finds the bus.
        log: Takes its standard error.
    """
    simulated = [setting for setting in settings if setting not in WITHOUT_NODES]
    words = [word for setting in simulated for word in ("--set", setting)]
    with log.open("ab") as errors:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "pcmrs.cli", "node", "sim", *DEVICES, *words,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=errors,
        )  # fmt: skip
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.send_signal(signal.SIGCONT)
            process.terminate()
        await end_child(process, END_TIME)


@asynccontextmanager
async def remote_cell(lab: Lab, weather: Weather) -> AsyncIterator[LabCell]:
    """A cell whose device node is one of another machine, as far as the wire between them goes."""
    port = free_port()
    place = lab.folder / "remote"
    place.mkdir()
    async with tcp_proxy(("127.0.0.1", port), weather) as (host, proxied):
        near = f"cell.endpoint=tcp/127.0.0.1:{port}"
        far = (f"cell.name={place.name}", f"cell.endpoint=tcp/{host}:{proxied}", "cell.rate=1", f"sim.seed={lab.seed}")
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
