"""kill -9 of a daemon in operation: what it had answered must be in its journal, word for word."""

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
"""A daemon that is killed at a random instant lives so long at most after it was ready, s of the machine."""

LATEST = 12
"""An armed daemon comes to its failpoint so often before it dies, after those of its start."""

AT_START = 8
"""Rows that a start writes at most: a failpoint of the journal counts from there on."""

DIES_WITHIN = 60.0
"""An armed daemon has come to its failpoint within this, s of the machine; otherwise it is killed then."""

PER_FOLDER = 20
"""So many daemons follow each other on one folder."""

SETTINGS = ("robot.deadman=0.5",)
SOURCE = "bus:local"


async def kill_daemons(
    times: int, seed: int, clock: Clock, *, minutes: float | None = None, progress: ShowProgress = lambda *_: None
) -> KillReport:
    """Kills daemons in operation, at every failpoint in turn and at random instants, each the successor of the last.

    Where one does not start, or its journal cannot be opened, nothing more can be seen, and it ends.

    Args:
        times: So many daemons.
        seed: Of instants, failpoints and what is operated.
        clock: The machine's.
        minutes: Ends earlier after so long.
        progress: Told after each.
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
            new, reached = await _killed(folder, place, tally.generator)
        except (DeviceError, BusError) as error:
            tally.refused.append(error.text)
            return
        answered |= new
        try:
            tally.count(place, len(new), _lost(folder / "ratms.sqlite", answered), reached=reached)
        except JournalError as error:
            tally.refused.append(error.text)
            return


async def _killed(folder: Path, place: str, generator: random.Random) -> tuple[dict[str, Verdict], bool]:
    """Operates a daemon until it is killed; returns what it has answered, and whether it was killed at `place`.

    Raises:
        DeviceError: It did not start, or ended by itself.
    """
    at_random = place == RANDOM
    first = AT_START if place.startswith("journal.") else 1
    armed = {} if at_random else {VARIABLE: f"{place}:{generator.randrange(first, first + LATEST)}"}
    operator: RandomOperator | None = None
    ended = None
    # A daemon that is killed takes its bus along, and some client of it may say so at the end of the context.
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
    """Operates a daemon until it ends, or is killed after so long; returns how it ended if it did so by itself."""

    async def go_on() -> None:
        while True:
            await operator.step()

    going_on, dying = asyncio.create_task(go_on()), asyncio.create_task(cell.process.wait())
    await asyncio.wait((dying,), timeout=longest)  # who asks may learn of its end before it has ended
    ended = cell.process.returncode
    if ended is None:
        with suppress(ProcessLookupError):
            cell.process.kill()
    await dying
    going_on.cancel()
    with suppress(asyncio.CancelledError, UnknownOutcomeError):
        await going_on
    return ended


def _lost(journal: Path, answered: Mapping[str, Verdict]) -> int:
    """How many verdicts are not in the journal as they were given.

    Raises:
        JournalError: It cannot be read.
    """
    with JournalReader(journal) as reader:
        return sum(reader.verdict_of(SOURCE, command) != verdict for command, verdict in answered.items())
