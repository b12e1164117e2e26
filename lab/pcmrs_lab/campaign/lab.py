"""What an injected fault works with: real daemons as processes, with folders and ports of their own."""

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
from pcmrs_lab.campaign.sham import is_sham

END_TIME = 60.0
"""A daemon that does not start has ended within this, s of the machine."""


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
    ) -> AsyncIterator[RunningCell]:
        """A fresh daemon for the length of the context.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each; ``sim.seed`` is the lab's.
            folder: The cell's folder: that of an earlier daemon for its successor; a new one by default.
            prefix: Words before the daemon's command line, such as ``strace`` and its options.
            environment: Variables that it has besides those of this process.
            delayed: The rules of `delays_of` the cell are obeyed.

        Raises:
            DeviceError: It did not start; the text has its last words.
        """
        self._daemons += 1
        place = folder or self.folder / f"cell{self._daemons}"
        settings = (f"sim.seed={self.seed}", *overrides)
        environment = {**(environment or {}), **_variables(place, delayed)}
        async with open_cell(place, settings, prefix=prefix, environment=environment) as cell:
            yield cell

    @asynccontextmanager
    async def cell(self, *overrides: str, anew: bool = True, delayed: bool = False) -> AsyncIterator[RunningCell]:
        """A daemon that an earlier fault may have used.

        It is kept for the next fault when the context ends without an error, so what was broken must have been mended.

        Args:
            overrides: Settings besides `QUICK`, ``key=value`` each.
            anew: Every branch is in its initial state; otherwise the head may be registered, and the tool at it.
            delayed: The rules of `delays_of` the cell are obeyed.
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
        command = serve_command([*own_settings(place, place.name), *QUICK, *overrides])
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.DEVNULL, stderr=pipe)
        try:
            async with asyncio.timeout(END_TIME):
                _, errors = await process.communicate()
        except TimeoutError:
            raise Unmet("The daemon was not refused: it runs.") from None
        finally:
            if process.returncode is None:
                await kill_and_wait(process)
        return process.returncode or 0, errors.decode(errors="replace")

    def log_tail(self) -> str:
        """The last lines of the newest daemon's log, for the report of a failure."""
        logs = sorted((*self.folder.glob("*/log"), *self._pool.logs()), key=lambda log: log.stat().st_mtime)
        return log_tail(logs[-1], 5) if logs else ""


class Pool:
    """Keeps one daemon alive from fault to fault, as long as they ask for the same settings.

    Args:
        folder: In which the cells have their folders.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept: tuple[tuple[tuple[str, ...], bool], RunningCell] | None = None
        self._stack = AsyncExitStack()
        self._daemons = 0

    @asynccontextmanager
    async def borrow(
        self, overrides: tuple[str, ...], seed: int, *, anew: bool, delayed: bool = False
    ) -> AsyncIterator[RunningCell]:
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

    async def _ready(self, overrides: tuple[str, ...], seed: int, *, anew: bool, delayed: bool) -> RunningCell:
        if self._kept is not None and self._kept[0] == (overrides, delayed):
            with suppress(PcmrsError):  # what an earlier fault has left must not fail this one
                await _prepare(self._kept[1], seed, anew=anew)
                return self._kept[1]
        await self.close()
        self._daemons += 1
        place = self._folder / f"shared{self._daemons}"
        opening = open_cell(place, overrides, environment=_variables(place, delayed))
        cell = await self._stack.enter_async_context(opening)
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


def _variables(folder: Path, delayed: bool) -> Mapping[str, str]:
    return Delays(folder / FOLDER).install() if delayed else {}


async def _prepare(cell: RunningCell, seed: int, *, anew: bool) -> None:
    await cell.scene.reseed(seed)
    await (reset_cell(cell.client) if anew else wait_until_stationary(cell.client))
