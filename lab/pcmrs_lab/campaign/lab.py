"""Surroundings of an injected fault: real daemons as processes, each with its own folder and ports."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path

from pcmrs.errors import PcmrsError
from pcmrs.killing import kill_and_wait
from pcmrs.testing.cell import QUICK, RunningCell, open_cell
from pcmrs.testing.daemon import log_tail, own_settings, serve_command
from pcmrs.testing.driving import reset_cell, wait_until_stationary
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.delays import FOLDER, Delays
from pcmrs_lab.campaign.sham import in_sham_campaign

END_TIME = 60.0
"""Time within which a daemon that does not start has ended, s of the machine."""


class Lab:
    """Surroundings of one injected fault.

    Args:
        seed: Seed of everything that is random.
        folder: Temporary folder for this fault.
        pool: Pool that keeps a daemon for the next fault; None for daemons that always end.

    Attributes:
        seed: Seed.
        folder: Folder.
        random: Generator with that seed.
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
    ) -> AsyncIterator[RunningCell]:
        """Start a new daemon for the length of the context.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each; ``sim.seed`` is the lab's.
            folder: Folder of the cell: that of an earlier daemon for its successor; a new one by default.
            prefix: Words before the daemon's command line, such as ``strace`` and its options.
            environment: Environment variables in addition to those of this process.
            delayed: True if the rules of `delays_of` the cell apply.

        Raises:
            DeviceError: The daemon did not start; the text has the end of its log.
        """
        self._daemons += 1
        place = folder or self.folder / f"cell{self._daemons}"
        settings = (f"sim.seed={self.seed}", *overrides)
        environment = {**(environment or {}), **_variables(place, delayed)}
        async with open_cell(place, settings, prefix=prefix, environment=environment) as cell:
            yield cell

    @asynccontextmanager
    async def cell(self, *overrides: str, fresh: bool = True, delayed: bool = False) -> AsyncIterator[RunningCell]:
        """Start a daemon, or use one of an earlier fault, for the length of the context.

        The daemon is kept for the next fault if the context ends without an error, so the fault must have been
        reverted.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each.
            fresh: True if every branch must be in its initial state; otherwise the head may be registered, and the tool
                at it.
            delayed: True if the rules of `delays_of` the cell apply.
        """
        async with self._pool.borrow(overrides, self.seed, fresh=fresh, delayed=delayed) as cell:
            yield cell

    async def start_refused(self, *overrides: str, folder: Path | None = None) -> tuple[int, str]:
        """Start a daemon that must refuse to start; return its exit status and standard error.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each.
            folder: Folder of the cell; a new one by default.

        Raises:
            Unmet: The daemon was still running after `END_TIME`.
        """
        self._daemons += 1
        place = folder or self.folder / f"cell{self._daemons}"
        command = serve_command([*own_settings(place, place.name), *QUICK, *overrides])
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.DEVNULL, stderr=pipe)
        try:
            async with asyncio.timeout(END_TIME):
                _, errors = await process.communicate()
        except TimeoutError:
            raise Unmet("The daemon started although it had to refuse.") from None
        finally:
            if process.returncode is None:
                await kill_and_wait(process)
        return process.returncode or 0, errors.decode(errors="replace")

    def log_tail(self) -> str:
        """Return the last lines of the newest daemon's log, for the report of a failure."""
        logs = sorted((*self.folder.glob("*/log"), *self._pool.logs()), key=lambda log: log.stat().st_mtime)
        return log_tail(logs[-1], 5) if logs else ""


class Pool:
    """Pool that keeps one daemon alive from fault to fault while they need the same settings.

    Args:
        folder: Parent of the folders of the cells.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._current: tuple[tuple[tuple[str, ...], bool], RunningCell] | None = None
        self._stack = AsyncExitStack()
        self._daemons = 0

    @asynccontextmanager
    async def borrow(
        self, overrides: tuple[str, ...], seed: int, *, fresh: bool, delayed: bool = False
    ) -> AsyncIterator[RunningCell]:
        """Lend the kept daemon, or a new one if the settings differ; end it if the context ends with an error.

        In a sham campaign a missing response damages nothing, so the daemon is kept.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each.
            seed: Seed of the simulation from now on.
            fresh: True if every branch must be in its initial state.
            delayed: True if the rules of `delays_of` the cell apply.
        """
        cell = await self._ready(overrides, seed, fresh=fresh, delayed=delayed)
        try:
            yield cell
        except BaseException as error:
            if isinstance(error, Unmet) and in_sham_campaign():
                raise
            await self.close()
            raise

    async def _ready(self, overrides: tuple[str, ...], seed: int, *, fresh: bool, delayed: bool) -> RunningCell:
        if self._current is not None and self._current[0] == (overrides, delayed):
            with suppress(PcmrsError):  # the state that an earlier fault left must not fail this one
                await _prepare(self._current[1], seed, fresh=fresh)
                return self._current[1]
        await self.close()
        self._daemons += 1
        place = self._folder / f"shared{self._daemons}"
        opening = open_cell(place, overrides, environment=_variables(place, delayed))
        cell = await self._stack.enter_async_context(opening)
        self._current = (overrides, delayed), cell
        await _prepare(cell, seed, fresh=fresh)
        return cell

    async def close(self) -> None:
        """End the kept daemon, if any."""
        self._current = None
        await self._stack.aclose()

    def logs(self) -> list[Path]:
        """Return the log files of all its daemons."""
        return list(self._folder.glob("shared*/log"))


def _variables(folder: Path, delayed: bool) -> Mapping[str, str]:
    return Delays(folder / FOLDER).install() if delayed else {}


async def _prepare(cell: RunningCell, seed: int, *, fresh: bool) -> None:
    await cell.scene.reseed(seed)
    await (reset_cell(cell.client) if fresh else wait_until_stationary(cell.client))
