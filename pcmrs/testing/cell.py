"""A daemon as a process, with a folder and ports of its own, and everybody who talks to it."""

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

QUICK = (
    "cell.rate=5",
    "robot.deadman=0.5",
    "procedure.max_pose_age=0.6",  # a machine that does much else may leave a process alone for so long
    "procedure.motion.joint_speed_fraction=1.0",
    "procedure.motion.joint_acceleration=5.0",
    "procedure.motion.linear_velocity=0.5",
    "procedure.placement.frames=5",
    "procedure.placement.tolerance_mm=0.5",  # of so few frames the mean is no better
    "procedure.placement.tolerance_deg=0.2",
    "procedure.registration.samples=5",
    "sim.digitization.reach_time=0.1",
    "sim.digitization.rest_time=0.1",
)
"""Settings of every daemon unless others are given: a cell that is quick where nothing depends on it."""
REAL_TIME = (
    "cell.rate=1",
    "procedure.max_pose_age=0.5",
    "procedure.following.longest_gap=0.2",
    "procedure.motion.linear_velocity=0.3",
    "robot.deadman=1.0",
)
"""Settings for what happens in real time: in the middle of a motion, while the tool follows, deadlines of devices."""


@dataclass(frozen=True, slots=True)
class RunningCell:
    """A running daemon, and everybody who talks to it.

    Attributes:
        process: The daemon, or the program that runs it.
        log_file: What daemon and nodes have written to standard error.
        client: Over the bus.
        planner: Over UDP.
        bus: As a device node or a console has it.
        scene: Truth and faults of the simulation.
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
        """The cell's."""
        return self.ready.prefix.split("/")[-1]

    @property
    def log(self) -> str:
        """Everything that daemon and nodes have written to standard error."""
        return self.log_file.read_text(errors="replace")

    def rows(self, after: int = 0) -> list[JournalRow]:
        """What the journal holds after a sequence number, read from the file."""
        with JournalReader(Path(self.ready.journal)) as journal:
            return [stored.row for stored in journal.read(after=after)]

    def last_row(self) -> int:
        """Sequence number of the journal's last row."""
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
        overrides: Settings besides `QUICK`, ``key=value`` each.
        prefix: Words before the daemon's command line, such as ``strace`` and its options.
        environment: Variables that the daemon has besides those of this process.

    Raises:
        DeviceError: It did not start; the text has its last words.
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
            error.add_note(f"The daemon's last words: {log_tail(log, 12)}")
            raise
