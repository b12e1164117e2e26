"""A running daemon as a process, with its own folder and ports, and its client, planner and bus."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.seal import Seal
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.planner import Planner
from pcmrs.service import Ready
from pcmrs.testing.daemon import device_key, log_tail, own_settings, running_daemon

__all__ = ["LIGHT", "QUICK", "REAL_TIME", "RunningCell", "open_cell"]

QUICK = (
    "cell.rate=5",
    "robot.deadman=0.5",
    "procedure.max_pose_age=0.6",  # a busy machine may leave a process without a processor for so long
    "procedure.motion.joint_speed_fraction=1.0",
    "procedure.motion.joint_acceleration=5.0",
    "procedure.motion.linear_velocity=0.5",
    "procedure.placement.frames=5",
    "procedure.placement.tolerance_mm=0.5",  # the mean of so few frames is not more accurate
    "procedure.placement.tolerance_deg=0.2",
    "procedure.registration.samples=5",
    "sim.digitization.reach_time=0.1",
    "sim.digitization.rest_time=0.1",
)
"""Default settings of every daemon: a fast cell."""
LIGHT = ("sim.arm.physics=kinematic", "sim.tracker.rate_hz=10", "sim.arm.state_rate_hz=10")
"""Settings for tests in which neither dynamics nor rates matter: a cell at rest takes half the processor time."""
REAL_TIME = (
    "cell.rate=1",
    "procedure.max_pose_age=0.5",
    "procedure.following.longest_gap=0.2",
    "procedure.motion.linear_velocity=0.3",
    "robot.deadman=1.0",
)
"""Settings for tests in real time: in the middle of a motion, while the tool follows, and of deadlines of devices."""


@dataclass(frozen=True, slots=True)
class RunningCell:
    """A running daemon, and its client, planner and bus.

    Attributes:
        process: Process of the daemon, or of the program that runs it.
        ready: Report of the daemon when it was ready.
        settings: Settings of the daemon, ``key=value`` each.
        folder: Folder of the cell.
        log_file: Standard error of daemon and nodes.
        client: Client over the bus.
        planner: Client of the planner link over UDP.
        bus: Bus with the rights of a device node.
        scene: Ground truth and faults of the simulation.
    """

    process: asyncio.subprocess.Process
    ready: Ready
    settings: tuple[str, ...]
    folder: Path
    log_file: Path
    client: Client
    planner: Planner
    bus: Bus
    scene: RemoteScene

    @property
    def name(self) -> str:
        """Name of the cell."""
        return self.ready.prefix.split("/")[-1]

    @property
    def log(self) -> str:
        """Standard error of daemon and nodes so far."""
        return self.log_file.read_text(errors="replace")

    def rows(self, after: int = 0) -> list[JournalRow]:
        """Return the rows of the journal after a sequence number, read from its file."""
        with JournalReader(Path(self.ready.journal)) as journal:
            return [stored.row for stored in journal.read(after=after)]

    def last_row(self) -> int:
        """Return the sequence number of the journal's last row."""
        with JournalReader(Path(self.ready.journal)) as journal:
            return max((stored.sequence for stored in journal.read(last=1)), default=0)


@asynccontextmanager
async def open_cell(
    folder: Path,
    overrides: Sequence[str],
    *,
    prefix: Sequence[str] = (),
    environment: Mapping[str, str] | None = None,
) -> AsyncIterator[RunningCell]:
    """Start a daemon in a folder, and open a client, a planner and a bus; all of them end with the context.

    Args:
        folder: Folder of the cell, which is made if it is missing; its name is the name of the cell.
        overrides: Settings in addition to `QUICK`, ``key=value`` each.
        prefix: Words before the daemon's command line, such as ``strace`` and its options.
        environment: Environment variables in addition to those of this process.

    Raises:
        DeviceError: The daemon did not start; the text has the end of its log.
    """
    settings, log = (*own_settings(folder, folder.name), *QUICK, *overrides), folder / "log"
    async with (
        running_daemon(settings, log, prefix=prefix, environment=environment) as daemon,
        AsyncExitStack() as stack,
    ):
        ready = daemon.ready
        key = device_key(folder)
        bus = await Bus.open(BusSettings(endpoint=ready.endpoint, cell=folder.name), Seal(key))
        stack.push_async_callback(bus.close)
        cell = RunningCell(
            process=daemon.process,
            ready=ready,
            settings=settings,
            folder=folder,
            log_file=log,
            client=await stack.enter_async_context(Client.connect(ready.endpoint, cell=folder.name, device_key=key)),
            planner=await stack.enter_async_context(await Planner.open(*ready.links["planner"])),
            bus=bus,
            scene=RemoteScene(bus, SystemClock()),
        )
        try:
            yield cell
        except Exception as error:
            error.add_note(f"The end of the daemon's log: {log_tail(log, 12)}")
            raise
