"""kill -9 of a daemon in operation: every answered verdict must be in its journal unchanged."""

from __future__ import annotations

import asyncio
import random
import signal
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from pcmrs.clock import Clock
from pcmrs.errors import BusError, DeviceError, JournalError, UnknownOutcomeError
from pcmrs.failpoints import FAILPOINTS, VARIABLE
from pcmrs.journal import JournalReader
from pcmrs.messages import Verdict
from pcmrs.testing.cell import RunningCell, open_cell
from pcmrs.testing.daemon import log_tail
from pcmrs_lab.campaign.kills import RANDOM, KillReport, ShowProgress, Tally
from pcmrs_lab.campaign.operating import RandomOperator

LONGEST = 4.0
"""Longest life of a daemon that is killed at a random instant, from when it is ready, s of the machine."""

LATEST = 12
"""Number of passes of a failpoint, after those of the start, before an armed daemon dies."""

AT_START = 8
"""Largest number of rows that a start writes; a failpoint of the journal counts from there."""

DIES_WITHIN = 60.0
"""Time in which an armed daemon reaches its failpoint, s of the machine; it is killed after that."""

PER_FOLDER = 20
"""Number of daemons that use one folder one after the other."""

SETTINGS = ("robot.deadman=0.5",)
SOURCE = "bus:local"


async def kill_daemons(
    times: int, seed: int, clock: Clock, *, minutes: float | None = None, progress: ShowProgress = lambda *_: None
) -> KillReport:
    """Kill daemons in operation, at every failpoint in turn and at random instants, each the successor of the last.

    The run ends early if a daemon does not start or its journal cannot be opened, since no result can follow.

    Args:
        times: Number of daemons.
        seed: Seed of the instants, failpoints and operations.
        clock: Clock of the machine.
        minutes: Time after which the run ends early, min.
        progress: Called after each daemon.

    Returns:
        Result of all daemons.
    """
    tally = Tally(clock, seed, times, minutes, progress)
    while not tally.done and not tally.refused:
        with tempfile.TemporaryDirectory(prefix="pcmrs-kills-", ignore_cleanup_errors=True) as folder:
            await _one_folder(Path(folder) / "cell", tally)
    return tally.report("a daemon in operation")


async def _one_folder(folder: Path, tally: Tally) -> None:
    answered: dict[str, Verdict] = {}
    places = (*FAILPOINTS, RANDOM)
    for _ in range(PER_FOLDER):
        if tally.done:
            return
        place = places[tally.kills % len(places)]
        try:
            new, reached = await _operate_until_killed(folder, place, tally.generator)
        except (DeviceError, BusError) as error:
            tally.refused.append(error.text)
            return
        answered |= new
        try:
            tally.count(place, len(new), _lost(folder / "ratms.sqlite", answered), reached=reached)
        except JournalError as error:
            tally.refused.append(error.text)
            return


async def _operate_until_killed(folder: Path, place: str, generator: random.Random) -> tuple[dict[str, Verdict], bool]:
    """Operate a daemon until it is killed; return its verdicts, and whether it was killed at `place`.

    Raises:
        DeviceError: The daemon did not start, or ended by itself.
    """
    at_random = place == RANDOM
    first = AT_START if place.startswith("journal.") else 1
    armed = {} if at_random else {VARIABLE: f"{place}:{generator.randrange(first, first + LATEST)}"}
    operator: RandomOperator | None = None
    ended = None
    # The bus ends with a killed daemon, and a client may report that at the end of the context.
    with suppress(UnknownOutcomeError):
        async with open_cell(folder, (*SETTINGS, f"sim.seed={generator.randrange(1000)}"), environment=armed) as cell:
            operator = RandomOperator(cell.client, generator)
            ended = await _operate(cell, operator, generator.uniform(0.0, LONGEST) if at_random else DIES_WITHIN)
    if ended is not None and (at_random or ended != -signal.SIGKILL):
        words = log_tail(folder / "log")
        raise DeviceError(f"A daemon in operation ended by itself, with exit status {ended}: {words}")
    if operator is None:
        return {}, False
    return operator.verdicts, at_random or ended is not None


async def _operate(cell: RunningCell, operator: RandomOperator, longest: float) -> int | None:
    """Operate a daemon until it ends or the time is over; return its exit status if it ended by itself."""

    async def operate() -> None:
        while True:
            await operator.step()

    operating, exiting = asyncio.create_task(operate()), asyncio.create_task(cell.process.wait())
    await asyncio.wait((exiting,), timeout=longest)  # the operator may fail before the process has exited
    ended = cell.process.returncode
    if ended is None:
        with suppress(ProcessLookupError):
            cell.process.kill()
    await exiting
    operating.cancel()
    with suppress(asyncio.CancelledError, UnknownOutcomeError):
        await operating
    return ended


def _lost(journal: Path, answered: Mapping[str, Verdict]) -> int:
    """Return how many verdicts are missing or different in the journal.

    Raises:
        JournalError: The journal cannot be read.
    """
    with JournalReader(journal) as reader:
        return sum(reader.verdict_of(SOURCE, command) != verdict for command, verdict in answered.items())
