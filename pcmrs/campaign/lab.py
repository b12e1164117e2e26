"""What an injected fault works with: real daemons as processes, with folders and ports of their own."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.seal import Seal
from pcmrs.campaign.delays import Delays
from pcmrs.campaign.driving import calmed, start_anew
from pcmrs.campaign.fault import Unmet
from pcmrs.campaign.sham import is_sham
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.errors import PcmrsError
from pcmrs.experiment.process import device_key, last_words, own_settings, running_daemon, serve_command
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.killing import killed
from pcmrs.planner import Planner
from pcmrs.service import Ready

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
"""For faults of what happens in real time: in the middle of a motion, while the tool follows, deadlines of devices."""

END_TIME = 60.0
"""A daemon that does not start has ended within this, s of the machine."""


@dataclass(frozen=True, slots=True)
class LabCell:
    """A running daemon, and everybody who talks to it.

    Attributes:
        process: The daemon, or the program that runs it.
        log_file: What daemon and nodes have written to standard error.
        client: Over the bus.
        planner: Over UDP.
        bus: As a device node or a console has it.
        scene: Truth and faults of the simulation.
        delays: Of the transport of daemon and nodes.
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
    delays: Delays

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


class Lab:
    """One injected fault's surroundings.

    Args:
        seed: Of everything that is random in it.
        folder: A temporary folder of its own.
        pool: Keeps a daemon for the next fault; None for daemons that always end.

    Attributes:
        seed: As given.
        folder: As given.
        random: A generator of that seed.
    """

    def __init__(self, seed: int, folder: Path, pool: Pool | None = None) -> None:
        self.seed = seed
        self.folder = folder
        self.random = random.Random(seed)
        self._pool = pool or Pool(folder)
        self._daemons = 0

    @asynccontextmanager
    async def daemon(
        self,
        *overrides: str,
        folder: Path | None = None,
        prefix: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        delayed: bool = False,
    ) -> AsyncIterator[LabCell]:
        """A fresh daemon for the length of the context.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each; ``sim.seed`` is the lab's.
            folder: The cell's folder: that of an earlier daemon for its successor; a new one by default.
            prefix: Words before the daemon's command line, such as ``strace`` and its options.
            environment: Variables that it has besides those of this process.
            delayed: The rules of its `LabCell.delays` are obeyed.

        Raises:
            DeviceError: It did not start; the text has its last words.
        """
        self._daemons += 1
        place = folder or self.folder / f"cell{self._daemons}"
        settings = (f"sim.seed={self.seed}", *overrides)
        async with open_cell(place, settings, prefix=prefix, environment=environment, delayed=delayed) as cell:
            yield cell

    @asynccontextmanager
    async def cell(self, *overrides: str, anew: bool = True, delayed: bool = False) -> AsyncIterator[LabCell]:
        """A daemon that an earlier fault may have used.

        It is kept for the next fault when the context ends without an error, so what was broken must have been mended.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each.
            anew: Every branch is in its initial state; otherwise the head may be registered, and the tool at it.
            delayed: The rules of its `LabCell.delays` are obeyed.
        """
        async with self._pool.borrow(overrides, self.seed, anew=anew, delayed=delayed) as cell:
            yield cell

    async def ending(self, *overrides: str, folder: Path | None = None) -> tuple[int, str]:
        """Exit status and standard error of a daemon that is to refuse to start.

        Raises:
            Unmet: It was still running after `END_TIME`.
        """
        self._daemons += 1
        place = folder or self.folder / f"cell{self._daemons}"
        command = serve_command([*own_settings(_made(place), place.name), *QUICK, *overrides])
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.DEVNULL, stderr=pipe)
        try:
            async with asyncio.timeout(END_TIME):
                _, errors = await process.communicate()
        except TimeoutError:
            raise Unmet("The daemon was not refused: it runs.") from None
        finally:
            if process.returncode is None:
                await killed(process)
        return process.returncode or 0, errors.decode(errors="replace")

    def last_words(self) -> str:
        """The last lines of the newest daemon's log, for the report of a failure."""
        logs = sorted((*self.folder.glob("*/log"), *self._pool.logs()), key=lambda log: log.stat().st_mtime)
        return last_words(logs[-1], 5) if logs else ""


class Pool:
    """Keeps one daemon alive from fault to fault, as long as they ask for the same settings.

    Args:
        folder: In which the cells have their folders.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept: tuple[tuple[tuple[str, ...], bool], LabCell] | None = None
        self._stack = AsyncExitStack()
        self._daemons = 0

    @asynccontextmanager
    async def borrow(
        self, overrides: tuple[str, ...], seed: int, *, anew: bool, delayed: bool = False
    ) -> AsyncIterator[LabCell]:
        """The kept daemon, or a new one where the settings are others; ended when the context ends with an error.

        Where no fault took place, a response that did not come breaks nothing: the daemon is kept.
        """
        cell = await self._ready(overrides, seed, anew=anew, delayed=delayed)
        try:
            yield cell
        except BaseException as error:
            if isinstance(error, Unmet) and is_sham():
                raise
            await self.close()
            raise

    async def _ready(self, overrides: tuple[str, ...], seed: int, *, anew: bool, delayed: bool) -> LabCell:
        if self._kept is not None and self._kept[0] == (overrides, delayed):
            with suppress(PcmrsError):  # what an earlier fault has left must not fail this one
                await _prepare(self._kept[1], seed, anew=anew)
                return self._kept[1]
        await self.close()
        self._daemons += 1
        place = self._folder / f"shared{self._daemons}"
        cell = await self._stack.enter_async_context(open_cell(place, overrides, delayed=delayed))
        self._kept = (overrides, delayed), cell
        await _prepare(cell, seed, anew=anew)
        return cell

    async def close(self) -> None:
        """Ends the daemon that is kept, if any."""
        self._kept = None
        await self._stack.aclose()

    def logs(self) -> list[Path]:
        """Of all its daemons."""
        return list(self._folder.glob("shared*/log"))


async def _prepare(cell: LabCell, seed: int, *, anew: bool) -> None:
    await cell.scene.reseed(seed)
    await (start_anew(cell.client) if anew else calmed(cell.client))


@asynccontextmanager
async def open_cell(
    folder: Path,
    overrides: Sequence[str],
    *,
    prefix: Sequence[str] = (),
    environment: Mapping[str, str] | None = None,
    delayed: bool = False,
) -> AsyncIterator[LabCell]:
    """A daemon in a folder, with a client, a planner and a bus.

    Raises:
        DeviceError: It did not start; the text has its last words.
    """
    settings, log = (*own_settings(_made(folder), folder.name), *QUICK, *overrides), folder / "log"
    delays = Delays(folder / "delays")
    if delayed:
        environment = {**(environment or {}), **delays.environment}
    async with (
        running_daemon(settings, log, prefix=prefix, environment=environment) as daemon,
        AsyncExitStack() as stack,
    ):
        ready = daemon.ready
        key = device_key(folder)
        bus = await Bus.open(BusSettings(endpoint=ready.endpoint, cell=folder.name), Seal(key))
        stack.push_async_callback(bus.close)
        cell = LabCell(
            process=daemon.process,
            ready=ready,
            settings=settings,
            folder=folder,
            log_file=log,
            client=await stack.enter_async_context(Client.connect(ready.endpoint, cell=folder.name, device_key=key)),
            planner=await stack.enter_async_context(await Planner.open(*ready.links["planner"])),
            bus=bus,
            scene=RemoteScene(bus, SystemClock()),
            delays=delays,
        )
        try:
            yield cell
        except Exception as error:
            error.add_note(f"The daemon's last words: {last_words(log, 12)}")
            raise


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder
