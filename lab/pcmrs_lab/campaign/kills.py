"""kill -9 of what writes the journal: everything that was acknowledged must be there afterwards."""

from __future__ import annotations

import math
import multiprocessing
import os
import random
import select
import signal
import tempfile
from collections import Counter
from collections.abc import Callable, Collection
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path

import msgspec

from pcmrs.clock import Clock
from pcmrs.errors import JournalError
from pcmrs.failpoints import FAILPOINTS
from pcmrs.journal import JournalReader
from pcmrs.journal.rows import GENESIS, chain_hash, encode_row
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.writing import REFUSED, SEQUENCE, write

RANDOM = "random instant"

LATEST = 30
"""An armed process dies before it comes to its failpoint so often."""

LONGEST = 0.05
"""A process that is killed at a random instant lives so long at most after it has begun to write, s of the machine."""

DIES_WITHIN = 30.0
"""A process that is armed has come to its failpoint within this, s of the machine."""

PER_JOURNAL = 100
"""So many processes write one journal after the other, before a new one is begun."""

OF_JOURNAL = tuple(name for name in FAILPOINTS if name.startswith("journal."))

ShowProgress = Callable[[str, int, int], None]


class KillReport(msgspec.Struct, frozen=True):
    """What was found.

    Attributes:
        what: Was killed.
        kills: Processes killed.
        at: How many of them died at which failpoint by the failpoint itself, and how many at random instants.
        not_reached: How many were armed for which failpoint and killed since they had not come there in time.
        acknowledged: Rows, or decisions of a daemon, that were acknowledged before.
        lost: Of these, how many were not there afterwards, or not as they had been.
        refused: Journals that could not be opened afterwards, in their own words; processes that ended by themselves.
        seed: Of the instants.
        seconds: s of the machine.
    """

    what: str
    kills: int
    at: dict[str, int]
    not_reached: dict[str, int]
    acknowledged: int
    lost: int
    refused: list[str]
    seed: int
    seconds: float

    @property
    def violated(self) -> bool:
        """Whether anything was lost, or cannot be read."""
        return self.lost > 0 or bool(self.refused)


def kill_writers(
    times: int, seed: int, clock: Clock, *, minutes: float | None = None, progress: ShowProgress = lambda *_: None
) -> KillReport:
    """Kills processes that write a journal: at every failpoint of the journal in turn, and at random instants.

    The kernel outlives them, so this is about what a process loses, not about what a disk does.

    Args:
        times: So many processes.
        seed: Of instants and failpoints.
        clock: The machine's.
        minutes: Ends earlier after so long.
        progress: Told after each.
    """
    tally = Tally(clock, seed, times, minutes, progress)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pcmrs_lab.campaign.kills"])
    while not tally.done:
        with tempfile.TemporaryDirectory(prefix="pcmrs-kills-") as folder:
            _one_journal(context, Path(folder) / "journal.sqlite", tally)
    return tally.report("a process that writes a journal")


class Tally:
    """What has been found so far; in a sham campaign nothing is killed."""

    def __init__(self, clock: Clock, seed: int, times: int, minutes: float | None, progress: ShowProgress) -> None:
        self.clock = clock
        self.generator = random.Random(seed)
        self.at: Counter[str] = Counter()
        self.not_reached: Counter[str] = Counter()
        self.acknowledged = self.lost = 0
        self.refused: list[str] = []
        self._seed, self._times, self._progress = seed, 0 if is_sham() else times, progress
        self._begun = clock.monotonic()
        self._end = math.inf if minutes is None else self._begun + minutes * 60.0

    @property
    def kills(self) -> int:
        return self.at.total() + self.not_reached.total()

    @property
    def done(self) -> bool:
        return self.kills >= self._times or self.clock.monotonic() >= self._end

    def count(self, place: str, acknowledged: int, lost: int, *, reached: bool) -> None:
        """A process was killed: at that place, or elsewhere since it had not come there."""
        (self.at if reached else self.not_reached)[place] += 1
        self.acknowledged += acknowledged
        self.lost += lost
        self._progress(f"killed at {place}" if reached else f"{place} not reached", self.kills, self._times)

    def report(self, what: str) -> KillReport:
        seconds = self.clock.monotonic() - self._begun
        at, not_reached = (
            {name: counted[name] for name in (*FAILPOINTS, RANDOM) if name in counted}
            for counted in (self.at, self.not_reached)
        )
        return KillReport(
            what, self.kills, at, not_reached, self.acknowledged, self.lost, self.refused, self._seed, seconds
        )


def _one_journal(context: ForkServerContext, path: Path, tally: Tally) -> None:
    """One process after the other writes the same journal and is killed, until one cannot open it."""
    checked, places = Checked(), (RANDOM, *OF_JOURNAL)
    for _ in range(PER_JOURNAL):
        if tally.done:
            return
        number, place = tally.kills, places[tally.kills % len(places)]
        try:
            told, reached = _killed(context, path, number, place, tally.generator, tally.clock)
            tally.count(place, len(told), lost_rows(path, f"run{number}", told, checked), reached=reached)
        except JournalError as error:
            tally.count(place, 0, 0, reached=False)
            tally.refused.append(error.text)
            return


class Checked(msgspec.Struct):
    """How far a journal has been found whole."""

    sequence: int = 0
    hash: bytes = GENESIS


def _killed(
    context: ForkServerContext, path: Path, number: int, place: str, generator: random.Random, clock: Clock
) -> tuple[list[int], bool]:
    """Has a process write until it is killed; returns what it was acknowledged, and whether it was killed at `place`.

    Raises:
        JournalError: It could not open the journal, or ended by itself.
    """
    at_random = place == RANDOM
    armed = "" if at_random else f"{place}:{generator.randrange(1, LATEST)}"
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(path, number, generator.randrange(1 << 30), armed, sender))
    process.start()
    sender.close()
    try:
        told = _read(receiver.fileno(), 8, clock.monotonic() + DIES_WITHIN, clock)
        lives = clock.monotonic() + (generator.uniform(0.0, LONGEST) if at_random else DIES_WITHIN)
        told += _read(receiver.fileno(), 0, lives, clock)
        process.join(max(0.0, lives - clock.monotonic()))  # what it was told by has closed before it has ended
        ended = process.exitcode
    finally:
        process.kill()
    told += _read(receiver.fileno(), 0, clock.monotonic() + DIES_WITHIN, clock)
    receiver.close()
    process.join()
    acknowledged = _acknowledged(told)
    if ended is not None and (at_random or ended != -signal.SIGKILL):
        raise JournalError(f"A process that writes the journal ended by itself, with exit status {ended}.")
    return acknowledged, at_random or ended is not None


def _run(path: Path, number: int, seed: int, armed: str, sender: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that kills this one
    write(path, f"run{number}", seed, armed, sender.fileno())


def _read(descriptor: int, enough: int, until: float, clock: Clock) -> bytes:
    """What comes until the sender has ended, there is enough (0: never), or time is up."""
    read = b""
    while not enough or len(read) < enough:
        ready, _, _ = select.select([descriptor], [], [], max(0.0, until - clock.monotonic()))
        piece = os.read(descriptor, enough or 65536) if ready else b""
        if not piece:
            break
        read += piece
    return read


def _acknowledged(told: bytes) -> list[int]:
    sequences = []
    for start in range(0, len(told) - len(told) % SEQUENCE.size, SEQUENCE.size):
        (sequence,) = SEQUENCE.unpack_from(told, start)
        if sequence == REFUSED:
            raise JournalError(told[start + SEQUENCE.size :].decode(errors="replace"))
        if sequence:
            sequences.append(sequence)
    return sequences


def lost_rows(path: Path, run: str, acknowledged: Collection[int], checked: Checked) -> int:
    """How many of the sequences are not there, or not of this run; the chain is followed from where it was whole.

    Raises:
        JournalError: It cannot be read, or the chain does not hold.
    """
    found = set()
    if not path.exists():
        return len(acknowledged)
    with JournalReader(path) as journal:
        for stored in journal.read(after=checked.sequence):
            own = chain_hash(checked.hash, stored.sequence, encode_row(stored.row))
            if (stored.sequence, stored.hash) != (checked.sequence + 1, own):
                raise JournalError(f"Row {stored.sequence} does not continue row {checked.sequence}.")
            checked.sequence, checked.hash = stored.sequence, own
            if stored.row.session_id == run:
                found.add(stored.sequence)
    return len(set(acknowledged) - found)
