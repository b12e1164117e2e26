"""Soak test: a cell is operated at random for hours; memory, file descriptors, threads and tasks must stay flat."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from pcmrs.clock import Clock
from pcmrs.errors import PcmrsError
from pcmrs.testing.cell import RunningCell, open_cell
from pcmrs.testing.daemon import processes_of
from pcmrs_lab.campaign.operating import RandomOperator
from pcmrs_lab.campaign.saboteur import order, sabotaged
from pcmrs_lab.campaign.samples import sample, slope

WARM_UP = 0.2
"""Share of the time before anything is compared, in which caches fill and modules are loaded."""

SAMPLES = 400
"""Number of samples of the whole run; at most one per second."""

LEAST_ACCEPTED = 0.5
"""Share of the commands that must be accepted: a cell that refuses everything is not operated."""

ALLOWED = {"memory": 8e6, "descriptors": 2.0, "threads": 2.0, "tasks": 4.0}
"""Rise over the run below which a measure counts as flat; it is also flat if the rise is not significant (3 standard
errors)."""

UNITS = {"memory": "bytes", "descriptors": "", "threads": "", "tasks": ""}

ShowProgress = Callable[[str, int, int], None]


class ResourceTrend(msgspec.Struct, frozen=True):
    """One measure of one process over time.

    Attributes:
        process: ``daemon``, ``node``, ``world`` or ``heart``.
        measure: Key of `ALLOWED`.
        times: Times since the start, s of the machine.
        rise: Rise of the line through the values after the warm-up, over that time.
        error: Standard error of `rise`.
    """

    process: str
    measure: str
    times: list[float]
    values: list[float]
    rise: float
    error: float

    @property
    def flat(self) -> bool:
        """True if it does not grow."""
        return self.rise < ALLOWED[self.measure] or self.rise < 3.0 * self.error


class SoakReport(msgspec.Struct, frozen=True):
    """Result of a soak test.

    Attributes:
        steps: Number of commands.
        decisions: Number of commands that were accepted, rejected, failed, unknown.
        rows: Rows of the journal at the end.
        ended: Error that ended the run early; empty if none did.
    """

    seconds: float
    seed: int
    steps: int
    stops: int
    decisions: dict[str, int]
    rows: int
    ended: str
    courses: list[ResourceTrend]

    @property
    def violated(self) -> bool:
        """True if it ended early, a measure grows, or too few commands were accepted to show anything."""
        idle = self.decisions.get("accepted", 0) < max(1.0, LEAST_ACCEPTED * self.steps)
        return bool(self.ended) or idle or not all(trend.flat for trend in self.courses)


async def soak(
    hours: float, seed: int, folder: Path, clock: Clock, *, progress: ShowProgress = lambda *_: None
) -> SoakReport:
    """Operate a cell for some hours, and sample its processes.

    Args:
        hours: Duration, h of the machine.
        seed: Seed of the operations.
        folder: Folder for the daemon; the caller removes it.
        clock: Clock of the machine.
        progress: Called after every sample.

    Returns:
        Result.
    """
    orders = folder / "orders"
    async with open_cell(folder / "soaked", ("robot.deadman=0.5",), prefix=sabotaged(orders)) as cell:
        operator, decisions = RandomOperator(cell.client, random.Random(seed)), Counter[str]()
        started = clock.monotonic()
        operating = asyncio.create_task(_operate(operator, decisions))
        seen: Seen = []
        try:
            await _look(cell, orders, operating, hours * 3600.0, clock, progress, seen)
            ended = _why_ended(operating)
        except OSError as error:
            ended = f"A process of the cell is gone or does not answer: {error}"
        finally:
            operating.cancel()
            await asyncio.gather(operating, return_exceptions=True)
        return SoakReport(
            seconds=clock.monotonic() - started,
            seed=seed,
            steps=decisions.total() + operator.stops,
            stops=operator.stops,
            decisions=dict(decisions),
            rows=cell.last_row() if not ended else 0,
            ended=ended,
            courses=_trends(seen),
        )


async def _operate(operator: RandomOperator, decisions: Counter[str]) -> None:
    while True:
        verdict = await operator.step()
        if verdict is not None:
            decisions[verdict.decision] += 1
            operator.verdicts.clear()


Seen = list[tuple[float, str, str, float]]
"""Time, process, measure, value."""


async def _look(
    cell: RunningCell,
    orders: Path,
    operating: asyncio.Task[None],
    length: float,
    clock: Clock,
    progress: ShowProgress,
    seen: Seen,
) -> None:
    """Sample all processes until the time is over or the operator has ended; raise `OSError` if one is gone."""
    started, period = clock.monotonic(), max(1.0, length / SAMPLES)
    processes = processes_of(cell.process.pid)
    while (now := clock.monotonic() - started) < length and not operating.done():
        for process, pid in processes:
            taken = msgspec.structs.asdict(sample(pid))
            seen += [(now, process, measure, float(value)) for measure, value in taken.items()]
        seen.append((now, "daemon", "tasks", float(await order(orders, "tasks"))))
        progress("seconds", int(now), int(length))
        await asyncio.wait([operating], timeout=min(period, max(0.0, length - now)))


def _why_ended(operating: asyncio.Task[None]) -> str:
    if not operating.done():
        return ""
    error = operating.exception()
    return error.text if isinstance(error, PcmrsError) else repr(error)


def _trends(seen: Seen) -> list[ResourceTrend]:
    courses = []
    for process, measure in dict.fromkeys((process, measure) for _, process, measure, _ in seen):
        points = [(time, value) for time, whose, what, value in seen if (whose, what) == (process, measure)]
        courses.append(trend(process, measure, [time for time, _ in points], [value for _, value in points]))
    return courses


def trend(process: str, measure: str, times: Sequence[float], values: Sequence[float]) -> ResourceTrend:
    """Return one measure with its line.

    Args:
        process: Name of the process.
        measure: Key of `ALLOWED`.
        times: Times since the start, s.
        values: Values at these times.
    """
    first = WARM_UP * times[-1] if times else 0.0
    late = [(time, value) for time, value in zip(times, values, strict=True) if time >= first]
    rising, error = slope([time for time, _ in late], [value for _, value in late])
    length = late[-1][0] - late[0][0] if late else 0.0
    return ResourceTrend(process, measure, list(times), list(values), rising * length, error * length)
