"""Journals whose files were cut, bent, or lost their power: whatever is missing must be said, never passed over."""

from __future__ import annotations

import asyncio
import random
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from pcmrs.campaign.recorded import after_power_cut, record
from pcmrs.campaign.writing import row
from pcmrs.clock import Clock
from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow

ROWS = 60
"""Of the journal that is damaged; some of them are in the database, some in the write-ahead log only."""

COMMITS = 400
"""Of the writer whose power is cut: enough for the write-ahead log to be taken into the database."""

TAIL = 2048
"""So many bytes at the end of database and log are cut at every byte."""

NAME = "journal.sqlite"
HEAD = f"{NAME}.head"
DAMAGED = (NAME, f"{NAME}-wal", HEAD)

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
    seed: int
    seconds: float

    @property
    def violated(self) -> bool:
        """Whether a loss was silent, or an error unexpected."""
        return bool(self.silent or self.broken or self.lost)


class Damage(msgspec.Struct, frozen=True):
    """One change of one file: it ends before `place`, or the bit `flip` of the byte there is another one."""

    file: str
    place: int
    flip: int | None = None

    def apply(self, folder: Path) -> None:
        """Changes the file in the folder."""
        path = folder / self.file
        content = bytearray(path.read_bytes())
        if self.flip is None:
            del content[self.place :]
        else:
            content[self.place] ^= 1 << self.flip
        path.write_bytes(content)

    def __str__(self) -> str:
        what = "cut at byte" if self.flip is None else f"bit {self.flip} flipped in byte"
        return f"{self.file} {what} {self.place}"


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
        cuts: So many random ones; None for every byte of the head's slots, and of the last `TAIL` of the others.
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
        damages = [
            (whole, damage)
            for count, flips_bits in ((cuts, False), (flips, True))
            for whole, damage in _damages((killed, closed), count, generator, flips=flips_bits)
        ]
        tally = _Tally("cut or bent", seed, len(rows))
        for number, (whole, damage) in enumerate(damages):
            if minutes is not None and clock.monotonic() - begun >= minutes * 60.0:
                break
            scratch = Path(name) / "scratch"
            shutil.copytree(whole, scratch)
            damage.apply(scratch)
            tally.judge(f"{whole.name}: {damage}", scratch, rows)
            shutil.rmtree(scratch)
            progress(str(damage), number + 1, len(damages))
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

    What was synchronised stays; of what was written since, a random part is there, whole or torn at a sector.

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
    tally = _Tally("power cut", seed, 0)
    with tempfile.TemporaryDirectory(prefix="pcmrs-cuts-") as name:
        base = Path(name) / "base"
        _written(Path(name) / "written", base, Path(name) / "closed")
        operations, rows = record(base, Path(name) / "recorded", commits, seed, durable=durable)
        for number in range(times):
            if minutes is not None and clock.monotonic() - begun >= minutes * 60.0:
                break
            place = generator.randrange(len(operations) + 1)
            scratch = Path(name) / "scratch"
            acknowledged = after_power_cut(base, operations[:place], scratch, generator)
            tally.judge_power_cut(f"cut {number} before call {place}", scratch, rows[:acknowledged])
            shutil.rmtree(scratch)
            progress("power cuts", number + 1, times)
    return tally.report(clock.monotonic() - begun)


class _Tally:
    """What has been found so far."""

    def __init__(self, what: str, seed: int, acknowledged: int) -> None:
        self._what, self._seed, self._acknowledged = what, seed, acknowledged
        self._tried = self._reported = self._unaffected = self._lost = 0
        self._silent: list[str] = []
        self._broken: list[str] = []

    def judge(self, what: str, folder: Path, rows: Sequence[StoredRow]) -> None:
        """A damaged journal: reported, or without effect."""
        self._tried += 1
        try:
            missing = asyncio.run(_missing(folder / NAME, rows))
        except JournalError:
            self._reported += 1
        except Exception as error:  # whatever it is, nobody could tell a user what to do
            self._broken.append(f"{what}: {type(error).__name__}: {error}")
        else:
            self._unaffected += not missing
            if missing:
                self._silent.append(f"{what}: {missing} rows are missing or others")

    def judge_power_cut(self, what: str, folder: Path, rows: Sequence[StoredRow]) -> None:
        """Power was cut: everything acknowledged must be there, and the journal must open."""
        self._tried += 1
        self._acknowledged += len(rows)
        try:
            missing = asyncio.run(_missing(folder / NAME, rows))
        except Exception as error:  # the next daemon would not start
            self._broken.append(f"{what}: {type(error).__name__}: {error}")
        else:
            self._unaffected += not missing
            self._lost += missing

    def report(self, seconds: float) -> CutReport:
        return CutReport(
            self._what, self._tried, self._acknowledged, self._reported, self._unaffected, self._lost,
            self._silent, self._broken, self._seed, seconds,
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


async def _missing(path: Path, rows: Iterable[StoredRow]) -> int:
    """How many rows are missing or others, once the journal was opened for writing, as a daemon does.

    Raises:
        JournalError: It was refused, then or when reading it.
    """
    journal = Journal.open(path)
    try:
        await journal.append([row("after", 0, 0)])
        with JournalReader(path) as reader:
            found = {stored.sequence: stored for stored in reader.read()}
    finally:
        with suppress(JournalError):
            await journal.close()
    return sum(found.get(stored.sequence) != stored for stored in rows)


def _damages(
    wholes: Sequence[Path], count: int | None, generator: random.Random, *, flips: bool
) -> list[tuple[Path, Damage]]:
    places = [(whole, file, place) for whole in wholes for file, place in _places(whole)]
    chosen = places if count is None else [generator.choice(places) for _ in range(count)]
    return [(whole, Damage(file, place, generator.randrange(8) if flips else None)) for whole, file, place in chosen]


def _places(folder: Path) -> Iterator[tuple[str, int]]:
    for name in DAMAGED:
        content = (folder / name).read_bytes() if (folder / name).exists() else b""
        if name == HEAD:
            yield from ((name, place) for place, byte in enumerate(content) if byte)  # the rest is padding
        else:
            yield from ((name, place) for place in range(max(0, len(content) - TAIL), len(content)))
