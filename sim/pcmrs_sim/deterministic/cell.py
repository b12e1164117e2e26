"""The whole cell in one process and in simulated time: daemon, device nodes, the simulated devices, the network."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, cast

from pcmrs.bus.keys import named_in
from pcmrs.config import as_table
from pcmrs.devices.node import DeviceNode
from pcmrs.devices.protocols import OpenDriver
from pcmrs.dispatcher import Workflow
from pcmrs.messages import Beat
from pcmrs.settings import Settings
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs_sim.deterministic.daemon import Observe, SimulatedDaemon
from pcmrs_sim.deterministic.disk import Disk
from pcmrs_sim.deterministic.network import Endpoint, Network

DRIVER = "sim"
SIMULATIONS = "pcmrs.simulations"
"""Group of the entry points that open devices in the process that asks, as simulated time needs it."""
NODE, DAEMON = "node", "daemon"
NOTICED = 0.005
"""The end of a node's process is noticed by its daemon after this, s."""

Devices = Mapping[str, Any]


class SimulatedCell:
    """Use `simulated_cell`.

    Args:
        network: Between its processes.
        settings: The whole configuration; all devices are simulated ones.
        workflow: The procedure, as opened.
        devices: The opened devices, as the node serves them.
        path: Of the journal.
        observe: Called with dispatcher and journal of every run of the daemon before anything is decided.

    Attributes:
        network: Between its processes.
        clock: Of the daemon's host.
        disk: Under the journal.
        devices: The opened devices.
        daemon: The present run of the daemon; None while there is none.
    """

    def __init__(
        self,
        network: Network,
        settings: Settings,
        workflow: Workflow[Cell, PlacementData],
        devices: Devices,
        path: Path,
        observe: Observe,
    ) -> None:
        self.network = network
        self.clock = SimulatedClock(asyncio.get_running_loop())
        self.disk = Disk(network.windows.open)
        self.devices = devices
        self.daemon: SimulatedDaemon | None = None
        self._node: Endpoint | None = None
        self._settings = settings
        self._workflow = workflow
        self._path = path
        self._observe = observe

    async def start_daemon(self) -> None:
        """Starts the daemon on the journal as it is; returns when it takes commands."""
        if self.daemon is None:
            link = self.network.endpoint(DAEMON)
            self.daemon = SimulatedDaemon(
                link, self._settings, self._workflow, self.clock, self.disk, self._path, self._observe
            )
            await self.daemon.start()

    async def crash_daemon(self) -> None:
        """Ends the daemon as SIGKILL does."""
        daemon, self.daemon = self.daemon, None
        if daemon is not None:
            await daemon.crash()

    async def end_daemon(self) -> None:
        """Ends the daemon as SIGTERM does."""
        daemon, self.daemon = self.daemon, None
        if daemon is not None:
            await daemon.end()

    def hold_up(self, process: str, seconds: float) -> None:
        """The loop of a process, ``daemon`` or ``node``, does nothing for so long, s."""
        if process == NODE and self._node is not None:
            self._node.hold_up(seconds)
        elif process == DAEMON and self.daemon is not None:
            self.daemon.link.hold_up(seconds)

    def start_node(self) -> None:
        """Starts the process that serves the devices."""
        if self._node is None:
            link = self._node = self.network.endpoint(NODE)
            clock = SimulatedClock(asyncio.get_running_loop())
            node = DeviceNode(link, self.devices, clock, self._settings.robot.deadman)
            link.subscribe("stop/*", Beat, lambda key, _: node.stop(f"bus:{named_in(key)}"))
            link.spawn(node.run())

    async def crash_node(self) -> None:
        """Ends the node as SIGKILL does; the devices live on, and the arm brakes by itself as its link is gone."""
        link, self._node = self._node, None
        if link is None:
            return
        link.leave()
        await self.devices["scene"].cut_robot(True)
        await link.ended()
        await self.devices["scene"].cut_robot(False)
        await asyncio.sleep(NOTICED)
        if self.daemon is not None:
            self.daemon.lose([name for name in self.devices if name != "scene"])


@asynccontextmanager
async def simulated_cell(
    settings: Settings,
    workflow: Workflow[Cell, PlacementData],
    path: Path,
    seed: int,
    *,
    coded: bool = False,
    watched: Callable[[Devices], Devices] = lambda devices: devices,
    observe: Observe = lambda *_: None,
) -> AsyncIterator[SimulatedCell]:
    """A cell that takes commands, in the simulated time of the running loop.

    Args:
        settings: The whole configuration; all devices are simulated ones.
        workflow: The procedure, as opened.
        path: Of the journal.
        seed: Of the network.
        coded: Whether messages are packed and unpacked.
        watched: Gives the devices as the node is to serve them.
        observe: See `SimulatedCell`.
    """
    loop = cast(SimulatedLoop, asyncio.get_running_loop())
    names = settings.drivers().get(DRIVER, [])
    async with _open_driver()(names, as_table(settings), SimulatedClock(loop)) as devices:
        cell = SimulatedCell(Network(loop, seed, coded=coded), settings, workflow, watched(devices), path, observe)
        cell.start_node()
        await cell.start_daemon()
        try:
            yield cell
        finally:
            await cell.end_daemon()
            await cell.crash_node()


@cache
def _open_driver() -> OpenDriver:
    (point,) = entry_points(group=SIMULATIONS, name=DRIVER)
    opened: OpenDriver = point.load()
    return opened
