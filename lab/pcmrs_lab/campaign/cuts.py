"""Journals whose files were cut, bent, or lost their power: whatever is missing must be said, never passed over."""

from __future__ import annotations

import asyncio
import random
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from pcmrs.clock import Clock
from pcmrs.journal import Journal, JournalReader, StoredRow
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import NAME, contents, place
from pcmrs_lab.campaign.damage import damages
from pcmrs_lab.campaign.journal_recovery_check import check_sound, missing_rows, taken_up
from pcmrs_lab.campaign.power_loss import power_cuts
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.syscall_trace import trace_journal
from pcmrs_lab.campaign.writing import row

ROWS = 60
"""Of the journal that is damaged; some of them are in the database, some in the write-ahead log only."""

COMMITS = 400
"""Of the writer whose power is cut: enough for the write-ahead log to be taken into the database."""

ShowProgress = Callable[[str, int, int], None]


class CutReport(msgspec.Struct, frozen=True):
    """What was found.

    Attributes:
        what: Was done to the files.
        tried: So many damaged journals were opened.
        acknowledged: Rows that each, or all power cuts together, had to have.
        reported: Journals that were refused with their reason.
        unaffected: Journals that had all rows.
        lost: Acknowledged rows that were missing after power cuts.
        silent: Damage that nobody reported: rows were missing or others.
        broken: Errors that were none of the journal's.
        changed: Journals whose files, read back, were others than before.
        whole: Undamaged journals, opened for the control, that had all rows.
        seconds: s of the machine.
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
        """Whether a loss was silent, or an error unexpected."""
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
    """Damages copies of the journal of a killed process, one at a time, and opens them.

    Args:
        cuts: So many random ones, in any file; None for every byte of the head's slots, and of the tails of the others.
        flips: So many random bits; None for one bit of every byte there.
        seed: Of what is random.
        clock: The machine's.
        minutes: Ends earlier after so long.
        progress: Told after each.
    """
    begun, generator = clock.monotonic(), random.Random(seed)
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
            tally.whole += taken_up(copy / NAME, rows)
            shutil.rmtree(copy)
        for number, (whole, damage) in enumerate(chosen):
            if minutes is not None and clock.monotonic() - begun >= minutes * 60.0:
                break
            scratch = Path(name) / "scratch"
            shutil.copytree(whole, scratch)
            damage.apply(scratch)
            tally.changed += contents(scratch) != contents(whole)
            tally.judge(f"{whole.name}: {damage}", scratch, rows)
            shutil.rmtree(scratch)
            progress(str(damage), number + 1, len(chosen))
    return tally.report(clock.monotonic() - begun)


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
    """Cuts the power of a journal's writer at random instants, between two system calls of a recording.

    What was synchronised stays; of what was written since, any sectors and any first changes of names are there.

    Args:
        times: So many cuts.
        seed: Of what is random.
        clock: The machine's.
        commits: Of the recording.
        durable: False for the control: a writer that waits for no disk, of which rows must be lost.
        minutes: Ends earlier after so long.
        progress: Told after each.

    Raises:
        NotRun: System calls cannot be recorded here.
    """
    begun, generator = clock.monotonic(), random.Random(seed)
    tally = _CutTally("power cut", seed, 0)
    with tempfile.TemporaryDirectory(prefix="pcmrs-cuts-") as name:
        written = Path(name) / "written"
        calls = trace_journal(written, commits, seed, durable=durable)
        with JournalReader(written / NAME) as reader:
            rows = {stored.sequence: stored for stored in reader.read()}
        for number, cut in enumerate(power_cuts(written, calls, times, generator)):
            if minutes is not None and clock.monotonic() - begun >= minutes * 60.0:
                break
            scratch = Path(name) / "scratch"
            place(contents(written) if is_sham() else cut.files, scratch)
            tally.changed += contents(scratch) != contents(written)
            acknowledged = [rows[sequence] for sequence in cut.acknowledged]
            tally.judge_power_cut(f"cut {number} before call {cut.call}", scratch, acknowledged)
            shutil.rmtree(scratch)
            progress("power cuts", number + 1, times)
    return tally.report(clock.monotonic() - begun)


class _CutTally:
    """What has been found so far."""

    def __init__(self, what: str, seed: int, acknowledged: int) -> None:
        self._what, self._seed, self._acknowledged = what, seed, acknowledged
        self._tried = self._reported = self._unaffected = self._lost = 0
        self._silent: list[str] = []
        self._broken: list[str] = []
        self.changed = self.whole = 0

    def judge(self, what: str, folder: Path, rows: Sequence[StoredRow]) -> None:
        """A damaged journal: reported, or without effect."""
        self._tried += 1
        try:
            whole = taken_up(folder / NAME, rows)
        except Unmet as error:
            self._silent.append(f"{what}: {error.text}")
        except Exception as error:  # whatever it is, nobody could tell a user what to do
            self._broken.append(f"{what}: {type(error).__name__}: {error}")
        else:
            self._unaffected += whole
            self._reported += not whole

    def judge_power_cut(self, what: str, folder: Path, rows: Sequence[StoredRow]) -> None:
        """Power was cut: everything acknowledged must be there, and the journal must open, and be sound then."""
        self._tried += 1
        self._acknowledged += len(rows)
        try:
            missing = asyncio.run(missing_rows(folder / NAME, rows))
            check_sound(folder / NAME)
        except Exception as error:  # the next daemon would not start
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
    """Writes a journal, copies its files as a kill would leave them and as they are once closed; returns its rows."""
    folder.mkdir()
    return asyncio.run(_write(folder, killed, closed))


async def _write(folder: Path, killed: Path, closed: Path) -> list[StoredRow]:
    journal = Journal.open(folder / NAME)
    for number in range(ROWS):
        await journal.append([row("base", 0, number)])
    shutil.copytree(folder, killed, ignore=shutil.ignore_patterns("*-shm"))
    rows = list(journal.reader.read())
    await journal.close()
    shutil.copytree(folder, closed, ignore=shutil.ignore_patterns("*-shm"))
    return rows
