"""Metrics of decisions and their latencies, and the counters of the daemon's parts."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from itertools import accumulate
from typing import get_args

from pcmrs.bus.commands import Submit
from pcmrs.clock import Clock
from pcmrs.messages import Command, Decision, DeviceEvent, Snapshot, Verdict
from pcmrs.messages.health import LatencyStatus

BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Upper bounds of the histogram of latencies, s: from a decision without a device to a long motion."""

DECISIONS: tuple[str, ...] = get_args(Decision)

RECENT = 1000
"""Number of newest commands that the percentiles are taken of."""


class CommandMetrics:
    """Numbers and latencies of the decisions since the start.

    Args:
        submit: `Dispatcher.submit`.
        clock: The machine's clock.

    Attributes:
        decisions: Decision to its number, including those on events of devices and posted commands.
        rejections: Reason code to its number of rejections.
    """

    def __init__(self, submit: Submit, clock: Clock) -> None:
        self.decisions = Counter(dict.fromkeys(DECISIONS, 0))
        self.rejections: Counter[str] = Counter()
        self._submit = submit
        self._clock = clock
        self._times: dict[str, _Times] = {}

    async def submit(self, command: Command, *, arrived: float | None = None) -> Verdict:
        """Submit a command of an edge, and measure the time until its verdict; see `Dispatcher.submit`.

        Args:
            command: The command.
            arrived: Time of its arrival, s of the event loop's clock; by default now.
        """
        began = self._clock.monotonic()
        verdict = await self._submit(command, arrived=arrived)
        self._times.setdefault(verdict.decision, _Times()).add(self._clock.monotonic() - began)
        return verdict

    def take(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Count a message of the dispatcher if it is a decision: each is published once."""
        if isinstance(message, Verdict):
            self.decisions[message.decision] += 1
            if message.decision == "rejected" and message.reason is not None:
                self.rejections[message.reason.code] += 1

    def latencies(self) -> list[LatencyStatus]:
        """Return the latencies of commands of the edges, by decision."""
        return [times.status(decision) for decision, times in sorted(self._times.items())]


class _Times:
    def __init__(self) -> None:
        self._sum = 0.0
        self._counts = [0] * (len(BOUNDS) + 1)
        self._recent: deque[float] = deque(maxlen=RECENT)

    def add(self, seconds: float) -> None:
        self._sum += seconds
        self._counts[bisect_left(BOUNDS, seconds)] += 1
        self._recent.append(seconds)

    def status(self, decision: str) -> LatencyStatus:
        *below, count = accumulate(self._counts)
        recent = sorted(self._recent)
        return LatencyStatus(
            decision=decision,
            count=count,
            sum=self._sum,
            p50=_nearest_rank(recent, 0.5),
            p99=_nearest_rank(recent, 0.99),
            buckets=list(zip(BOUNDS, below, strict=True)),
        )


def _nearest_rank(ordered: list[float], fraction: float) -> float:
    """Smallest value that at least this fraction of the values does not exceed."""
    return ordered[math.ceil(fraction * len(ordered)) - 1]


Source = Callable[[], Mapping[str, int]]


def counted(sources: Iterable[Source]) -> dict[str, int]:
    """Return the counters of all parts by their unique names, such as ``bus.refused`` or ``loop.stalls``."""
    return {name: many for source in sources for name, many in source().items()}
