"""The whole cell in one process and in simulated time: daemon, device nodes, the simulated devices, the network."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import cache
from pathlib import Path
from typing import Any, cast

from pcmrs.bus.stop import StopLane
from pcmrs.config import as_table
from pcmrs.devices.node import DeviceNode
from pcmrs.devices.protocols import OpenDriver
from pcmrs.dispatcher import Workflow
from pcmrs.installed import entry_points_of
from pcmrs.settings import Settings
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs_sim.deterministic.daemon import Observe, SimulatedDaemon
from pcmrs_sim.deterministic.disk import Disk
from pcmrs_sim.deterministic.network import Endpoint, Network
from pcmrs_sim.deterministic.stops import open_lane

DRIVER = "sim"
SIMULATIONS = "pcmrs.simulations"
"""Group of entry points that open devices in the calling process. Simulated time needs all devices in one process."""
NODE, DAEMON = "node", "daemon"
EXIT_NOTICE_TIME = 0.005
"""Time after which the daemon notices that the node's process has ended, s."""

Devices = Mapping[str, Any]


class SimulatedCell:
    """A daemon, a device node and the simulated devices. Open one with `simulated_cell`.

    Args:
        network: Network between its processes.
        settings: The whole configuration; all devices are simulated ones.
        workflow: The opened procedure.
        devices: The opened devices, as the node serves them.
        path: Journal file.
        observe: Called with the dispatcher and the journal of each run of the daemon, before its first decision.

    Attributes:
        network: Network between its processes.
        clock: Clock of the daemon's host.
        disk: Disk that holds the journal.
        devices: The opened devices.
        daemon: The present run of the daemon; None while no daemon runs.
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
        self._lane: StopLane | None = None
        self._settings = settings
        self._workflow = workflow
        self._path = path
        self._observe = observe

    async def start_daemon(self) -> None:
        """Start the daemon on the existing journal, unless it runs; return when it takes commands.

        Raises:
            PcmrsError: The daemon cannot start.
        """
        if self.daemon is None:
            link = self.network.endpoint(DAEMON)
            self.daemon = SimulatedDaemon(
                link, self._settings, self._workflow, self.clock, self.disk, self._path, self._observe
            )
            await self.daemon.start()

    async def crash_daemon(self) -> None:
        """End the daemon as SIGKILL does."""
        daemon, self.daemon = self.daemon, None
        if daemon is not None:
            await daemon.crash()

    async def end_daemon(self) -> None:
        """End the daemon as SIGTERM does."""
        daemon, self.daemon = self.daemon, None
        if daemon is not None:
            await daemon.end()

    def hold_up(self, process: str, seconds: float) -> None:
        """Stall the event loop of a process.

        Args:
            process: ``daemon`` or ``node``.
            seconds: Length of the stall, s.
        """
        if process == NODE and self._node is not None:
            self._node.hold_up(seconds)
        elif process == DAEMON and self.daemon is not None:
            self.daemon.link.hold_up(seconds)

    def start_node(self) -> None:
        """Start the process that serves the devices, unless it runs."""
        if self._node is None:
            link = self._node = self.network.endpoint(NODE)
            clock = SimulatedClock(asyncio.get_running_loop())
            node = DeviceNode(link, self.devices, clock, self._settings.robot.deadman)
            self._lane = open_lane(link, lambda source, _: node.stop(source))
            link.spawn(node.run())

    async def crash_node(self) -> None:
        """End the node as SIGKILL does. The devices continue; the arm brakes by itself because its link is gone."""
        link, self._node = self._node, None
        if link is None:
            return
        link.leave()
        if self._lane is not None:
            self._lane.end()  # its thread would outlive the process
        # The arm brakes as if its link broke. The link is restored for the next node.
        await self.devices["scene"].cut_robot(True)
        await link.ended()
        await self.devices["scene"].cut_robot(False)
        await asyncio.sleep(EXIT_NOTICE_TIME)
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
    """Open a cell in the simulated time of the running loop; yield it when it takes commands.

    Args:
        settings: The whole configuration; all devices are simulated ones.
        workflow: The opened procedure.
        path: Journal file.
        seed: Seed of the network's delays, losses and order.
        coded: Pack and unpack each message, as the real bus does.
        watched: Takes the opened devices, and returns the ones that the node serves in their place.
        observe: See `SimulatedCell`.

    Raises:
        PcmrsError: The daemon cannot start.
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
    (point,) = (each for each in entry_points_of(SIMULATIONS) if each.name == DRIVER)
    opened: OpenDriver = point.load()
    return opened
