"""kill -9 of processes that write a journal: every acknowledged row must be there afterwards."""

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
"""An armed process reaches its failpoint fewer times than this before it dies."""

LONGEST = 0.05
"""Longest life of a process that is killed at a random instant, from its first write, s of the machine."""

DIES_WITHIN = 30.0
"""Time in which an armed process reaches its failpoint, s of the machine."""

PER_JOURNAL = 100
"""Number of processes that write one journal one after the other before a new one is started."""

JOURNAL_FAILPOINTS = tuple(name for name in FAILPOINTS if name.startswith("journal."))

ShowProgress = Callable[[str, int, int], None]


class KillReport(msgspec.Struct, frozen=True):
    """Result of killed processes.

    Attributes:
        what: Kind of process.
        kills: Number of killed processes.
        at: Number of processes that died at each failpoint by the failpoint itself, and at random instants.
        not_reached: Number of processes, by failpoint, that were killed because they had not reached it in time.
        acknowledged: Number of rows, or decisions of a daemon, that were acknowledged before.
        lost: Number of these that were missing or changed afterwards.
        refused: Errors of journals that could not be opened afterwards, and of processes that ended by themselves.
        seed: Seed of the instants.
        seconds: Duration, s of the machine.
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
        """True if anything was lost, or cannot be read."""
        return self.lost > 0 or bool(self.refused)


def kill_writers(
    times: int, seed: int, clock: Clock, *, minutes: float | None = None, progress: ShowProgress = lambda *_: None
) -> KillReport:
    """Kill processes that write a journal: at every failpoint of the journal in turn, and at random instants.

    The kernel survives, so this shows what a process loses, not what a disk does.

    Args:
        times: Number of processes.
        seed: Seed of the instants and failpoints.
        clock: Clock of the machine.
        minutes: Time after which the run ends early, min.
        progress: Called after each process.

    Returns:
        Result of all processes.
    """
    tally = Tally(clock, seed, times, minutes, progress)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pcmrs_lab.campaign.kills"])
    while not tally.done:
        with tempfile.TemporaryDirectory(prefix="pcmrs-kills-") as folder:
            _one_journal(context, Path(folder) / "journal.sqlite", tally)
    return tally.report("a process that writes a journal")


class Tally:
    """Running totals; nothing is killed in a sham campaign.

    Args:
        clock: Clock of the machine.
        seed: Seed of the random choices.
        times: Number of processes to kill.
        minutes: Time after which `done` is true, min; None for no limit.
        progress: Called after each process.
    """

    def __init__(self, clock: Clock, seed: int, times: int, minutes: float | None, progress: ShowProgress) -> None:
        self.clock = clock
        self.generator = random.Random(seed)
        self.at: Counter[str] = Counter()
        self.not_reached: Counter[str] = Counter()
        self.acknowledged = self.lost = 0
        self.refused: list[str] = []
        self._seed, self._times, self._progress = seed, 0 if is_sham() else times, progress
        self._started = clock.monotonic()
        self._end = math.inf if minutes is None else self._started + minutes * 60.0

    @property
    def kills(self) -> int:
        """Number of killed processes."""
        return self.at.total() + self.not_reached.total()

    @property
    def done(self) -> bool:
        """True if enough processes were killed, or the time is over."""
        return self.kills >= self._times or self.clock.monotonic() >= self._end

    def count(self, place: str, acknowledged: int, lost: int, *, reached: bool) -> None:
        """Count a killed process.

        Args:
            place: Failpoint at which it was to die, or `RANDOM`.
            acknowledged: Number of rows that it had acknowledged.
            lost: Number of acknowledged rows that are missing.
            reached: True if it died at the failpoint; False if it was killed before it got there.
        """
        (self.at if reached else self.not_reached)[place] += 1
        self.acknowledged += acknowledged
        self.lost += lost
        self._progress(f"killed at {place}" if reached else f"{place} not reached", self.kills, self._times)

    def report(self, what: str) -> KillReport:
        """Return the result for this kind of process."""
        seconds = self.clock.monotonic() - self._started
        at, not_reached = (
            {name: counted[name] for name in (*FAILPOINTS, RANDOM) if name in counted}
            for counted in (self.at, self.not_reached)
        )
        return KillReport(
            what, self.kills, at, not_reached, self.acknowledged, self.lost, self.refused, self._seed, seconds
        )


def _one_journal(context: ForkServerContext, path: Path, tally: Tally) -> None:
    """Have one process after the other write the same journal and be killed, until one cannot open it."""
    checked, places = VerifiedPrefix(), (RANDOM, *JOURNAL_FAILPOINTS)
    for _ in range(PER_JOURNAL):
        if tally.done:
            return
        number, place = tally.kills, places[tally.kills % len(places)]
        try:
            output, reached = _run_until_killed(context, path, number, place, tally.generator, tally.clock)
            tally.count(place, len(output), lost_rows(path, f"run{number}", output, checked), reached=reached)
        except JournalError as error:
            tally.count(place, 0, 0, reached=False)
            tally.refused.append(error.text)
            return


class VerifiedPrefix(msgspec.Struct):
    """End of the part of a journal that has been found whole: sequence and hash of its last row."""

    sequence: int = 0
    hash: bytes = GENESIS


def _run_until_killed(
    context: ForkServerContext, path: Path, number: int, place: str, generator: random.Random, clock: Clock
) -> tuple[list[int], bool]:
    """Have a process write until it is killed; return the acknowledged sequences, and whether it was killed at `place`.

    Raises:
        JournalError: The process could not open the journal, or ended by itself.
    """
    at_random = place == RANDOM
    armed = "" if at_random else f"{place}:{generator.randrange(1, LATEST)}"
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(path, number, generator.randrange(1 << 30), armed, sender))
    process.start()
    sender.close()
    try:
        output = _read(receiver.fileno(), 8, clock.monotonic() + DIES_WITHIN, clock)
        lives = clock.monotonic() + (generator.uniform(0.0, LONGEST) if at_random else DIES_WITHIN)
        output += _read(receiver.fileno(), 0, lives, clock)
        process.join(max(0.0, lives - clock.monotonic()))  # its pipe closes before the process has ended
        ended = process.exitcode
    finally:
        process.kill()
    output += _read(receiver.fileno(), 0, clock.monotonic() + DIES_WITHIN, clock)
    receiver.close()
    process.join()
    acknowledged = _acknowledged(output)
    if ended is not None and (at_random or ended != -signal.SIGKILL):
        raise JournalError(f"A process that writes the journal ended by itself, with exit status {ended}.")
    return acknowledged, at_random or ended is not None


def _run(path: Path, number: int, seed: int, armed: str, sender: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that kills this one
    write(path, f"run{number}", seed, armed, sender.fileno())


def _read(descriptor: int, enough: int, until: float, clock: Clock) -> bytes:
    """Read until the sender has closed, `enough` bytes have come (0 for no limit), or the time is over."""
    read = b""
    while not enough or len(read) < enough:
        ready, _, _ = select.select([descriptor], [], [], max(0.0, until - clock.monotonic()))
        piece = os.read(descriptor, enough or 65536) if ready else b""
        if not piece:
            break
        read += piece
    return read


def _acknowledged(output: bytes) -> list[int]:
    sequences = []
    for start in range(0, len(output) - len(output) % SEQUENCE.size, SEQUENCE.size):
        (sequence,) = SEQUENCE.unpack_from(output, start)
        if sequence == REFUSED:
            raise JournalError(output[start + SEQUENCE.size :].decode(errors="replace"))
        if sequence:
            sequences.append(sequence)
    return sequences


def lost_rows(path: Path, run: str, acknowledged: Collection[int], checked: VerifiedPrefix) -> int:
    """Return how many acknowledged rows are missing or of another run, and verify the chain of new rows.

    Args:
        path: Database file of the journal.
        run: Session id of the run that wrote the rows.
        acknowledged: Acknowledged sequence numbers.
        checked: Part of the journal that was verified before; it is updated.

    Raises:
        JournalError: The journal cannot be read, or its chain is broken.
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
