"""Journals with cut or changed files, or after a power loss: missing rows must be reported, never silently ignored."""

from __future__ import annotations

import asyncio
import random
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import msgspec

from pcmrs.clock import Clock
from pcmrs.journal import Journal, JournalReader, StoredRow
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import NAME, contents, place, row
from pcmrs.testing.journal_recovery import check_sound, is_recovered, missing_rows
from pcmrs_lab.campaign.damage import damages
from pcmrs_lab.campaign.power_loss import power_cuts
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.syscall_trace import trace_journal

ROWS = 60
"""Number of rows of the journal that is damaged; some are in the database, some only in the write-ahead log."""

COMMITS = 400
"""Commits of the writer whose power is cut: enough for SQLite to move the write-ahead log into the database."""

ShowProgress = Callable[[str, int, int], None]


class CutReport(msgspec.Struct, frozen=True):
    """Result of damaged journals or power cuts.

    Attributes:
        what: Kind of damage.
        tried: Number of damaged journals that were opened.
        acknowledged: Rows that each journal, or all power cuts together, must have.
        reported: Number of journals that were refused with their reason.
        unaffected: Number of journals with all rows.
        lost: Number of acknowledged rows that were missing after power cuts.
        silent: Damage that was not reported although rows were missing or changed.
        broken: Unexpected errors.
        changed: Number of journals whose files differed when read back.
        whole: Number of undamaged journals, opened as a control, that had all rows.
        seconds: Duration, s of the machine.
        seed: Seed of the random damage.
    """

    what: str
    tried: int
    acknowledged: int
    reported: int
    unaffected: int
    lost: int
    silent: list[str]
    broken: list[str]
    changed: int
    whole: int
    seed: int
    seconds: float

    @property
    def violated(self) -> bool:
        """True if a loss was silent, or an error unexpected."""
        return bool(self.silent or self.broken or self.lost)


def cut_and_flip(
    cuts: int | None,
    flips: int | None,
    seed: int,
    clock: Clock,
    *,
    minutes: float | None = None,
    progress: ShowProgress = lambda *_: None,
) -> CutReport:
    """Damage copies of the journal of a killed process, one at a time, and open them.

    Args:
        cuts: Number of random cuts, in any file; None for every byte of the head's slots, and of the tails of the
            others.
        flips: Number of random bits; None for one bit of every byte there.
        seed: Seed of the random choices.
        clock: Clock of the machine.
        minutes: Time after which the run ends early, min.
        progress: Called after each journal.

    Returns:
        Result of all journals.
    """
    started, generator = clock.monotonic(), random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="pcmrs-cuts-") as name:
        killed, closed = Path(name) / "killed", Path(name) / "closed"
        rows = _written(Path(name) / "written", killed, closed)
        chosen = [
            (whole, damage)
            for count, flips_bits in ((cuts, False), (flips, True))
            for whole, damage in damages((killed, closed), count, generator, flips=flips_bits)
        ]
        tally = _CutTally("cut or bent", seed, len(rows))
        for whole in (killed, closed):
            copy = shutil.copytree(whole, Path(name) / "control")
            tally.whole += is_recovered(copy / NAME, rows)
            shutil.rmtree(copy)
        for number, (whole, damage) in enumerate(chosen):
            if minutes is not None and clock.monotonic() - started >= minutes * 60.0:
                break
            scratch = Path(name) / "scratch"
            shutil.copytree(whole, scratch)
            inject_unless_sham(partial(damage.apply, scratch))
            tally.changed += contents(scratch) != contents(whole)
            tally.judge(f"{whole.name}: {damage}", scratch, rows)
            shutil.rmtree(scratch)
            progress(str(damage), number + 1, len(chosen))
    return tally.report(clock.monotonic() - started)


def cut_power(
    times: int,
    seed: int,
    clock: Clock,
    *,
    commits: int = COMMITS,
    durable: bool = True,
    minutes: float | None = None,
    progress: ShowProgress = lambda *_: None,
) -> CutReport:
    """Cut the power of a journal's writer at random instants, between two system calls of a recording.

    Synchronised data stays. Of the data written since, any sectors are present, and any first part of the name changes.

    Args:
        times: Number of cuts.
        seed: Seed of the random choices.
        clock: Clock of the machine.
        commits: Number of commits of the recording.
        durable: False for the control: a writer that does not wait for the disk and must lose rows.
        minutes: Time after which the run ends early, min.
        progress: Called after each cut.

    Returns:
        Result of all cuts.

    Raises:
        NotRun: System calls cannot be recorded on this machine.
    """
    started, generator = clock.monotonic(), random.Random(seed)
    tally = _CutTally("power cut", seed, 0)
    with tempfile.TemporaryDirectory(prefix="pcmrs-cuts-") as name:
        written = Path(name) / "written"
        calls = trace_journal(written, commits, seed, durable=durable)
        with JournalReader(written / NAME) as reader:
            rows = {stored.sequence: stored for stored in reader.read()}
        for number, cut in enumerate(power_cuts(written, calls, times, generator)):
            if minutes is not None and clock.monotonic() - started >= minutes * 60.0:
                break
            scratch = Path(name) / "scratch"
            place(contents(written) if is_sham() else cut.files, scratch)
            tally.changed += contents(scratch) != contents(written)
            acknowledged = [rows[sequence] for sequence in cut.acknowledged]
            tally.judge_power_cut(f"cut {number} before call {cut.call}", scratch, acknowledged)
            shutil.rmtree(scratch)
            progress("power cuts", number + 1, times)
    return tally.report(clock.monotonic() - started)


class _CutTally:
    """Running totals."""

    def __init__(self, what: str, seed: int, acknowledged: int) -> None:
        self._what, self._seed, self._acknowledged = what, seed, acknowledged
        self._tried = self._reported = self._unaffected = self._lost = 0
        self._silent: list[str] = []
        self._broken: list[str] = []
        self.changed = self.whole = 0

    def judge(self, what: str, folder: Path, rows: Sequence[StoredRow]) -> None:
        """Count a damaged journal, which must be reported or have all rows."""
        self._tried += 1
        try:
            whole = is_recovered(folder / NAME, rows)
        except Unmet as error:
            self._silent.append(f"{what}: {error.text}")
        except Exception as error:  # any other error would leave a user without advice
            self._broken.append(f"{what}: {type(error).__name__}: {error}")
        else:
            self._unaffected += whole
            self._reported += not whole

    def judge_power_cut(self, what: str, folder: Path, rows: Sequence[StoredRow]) -> None:
        """Count a power cut: all acknowledged rows must be present, and the journal must open and verify."""
        self._tried += 1
        self._acknowledged += len(rows)
        try:
            missing = asyncio.run(missing_rows(folder / NAME, rows))
            check_sound(folder / NAME)
        except Exception as error:  # the next daemon could not start
            self._broken.append(f"{what}: {type(error).__name__}: {error}")
        else:
            self._unaffected += not missing
            self._lost += missing

    def report(self, seconds: float) -> CutReport:
        return CutReport(
            self._what, self._tried, self._acknowledged, self._reported, self._unaffected, self._lost,
            self._silent, self._broken, self.changed, self.whole, self._seed, seconds,
        )  # fmt: skip


def _written(folder: Path, killed: Path, closed: Path) -> list[StoredRow]:
    """Write a journal, copy its files as a kill leaves them and as they are once closed, and return its rows."""
    folder.mkdir()
    return asyncio.run(_write(folder, killed, closed))


async def _write(folder: Path, killed: Path, closed: Path) -> list[StoredRow]:
    journal = Journal.open(folder / NAME)
    for number in range(ROWS):
        await journal.append([row("base", 0, number)])
    # SQLite rebuilds the shared-memory index when it opens a journal, so the index is not part of the copies.
    shutil.copytree(folder, killed, ignore=shutil.ignore_patterns("*-shm"))
    rows = list(journal.reader.read())
    await journal.close()
    shutil.copytree(folder, closed, ignore=shutil.ignore_patterns("*-shm"))
    return rows
