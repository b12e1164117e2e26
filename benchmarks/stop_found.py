"""Results of the benchmark of Stop, in simulated time and on a real daemon, and their limits."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from pcmrs.devices.motion.follower import brake_limits
from pcmrs.kinematics.trajectory import brake
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import HeadMotion
from pcmrs.spatial import Floats
from pcmrs_lab.campaign.lateness import percentile
from pcmrs_lab.campaign.stop_limits import DURING_FLOODS
from pcmrs_sim.settings import SimSettings

BREATHING = HeadMotion(breathing_amplitude=0.003, breathing_hz=0.3)
"""Motion of the head that the tool follows."""

LATCHED, BRAKING = "stop received to hold sent", "hold received to braking"
STANDSTILL, SILENCE = "braking to standstill", "sign of life to hold"
"""The four times of a Stop."""
DURING, TIMER = "asked to begun, flood of ", "bare timer, flood of "
"""Prefixes of the names of measurements during a flood."""
LIMITS = {LATCHED: {"p99": 0.020}, BRAKING: {"max": 0.020}, SILENCE: {"max": 0.125}}
"""Limits of the times beyond a bare timer's lateness, s. The limit of braking follows from its distance."""

_FACTS, _ARM = find_arm("iiwa14"), SimSettings().arm
_LIMITS = brake_limits(_FACTS, _ARM.brake_acceleration, _ARM.brake_jerk)


@dataclass(frozen=True, slots=True)
class Braking:
    """Expected stop of an arm that begins to brake.

    Attributes:
        started_at: Time at which it begins, s.
        start: Joint positions then, rad, (n,).
        end: Joint positions at rest, by its speed and the limits of its brakes, rad, (n,).
        lasts: Duration, s.
    """

    started_at: float
    start: Floats
    end: Floats
    lasts: float

    @classmethod
    def at(cls, started_at: float, positions: Sequence[float], velocities: Sequence[float]) -> Self:
        """Return the expected stop from a state of the arm.

        Args:
            started_at: Time at which it begins, s.
            positions: Joint positions, rad.
            velocities: Joint velocities, rad/s.
        """
        stop = brake(positions, velocities, _LIMITS)
        lasts = stop.period * (len(stop.positions) - 1)
        return cls(started_at, np.array(positions), np.array(stop.positions[-1]), lasts)

    def beyond(self, positions: Floats) -> float:
        """Return how far the outermost joint lies beyond its braking distance, rad; 0 if none does."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        return float(np.maximum(np.maximum(low - positions, positions - high), 0.0).max())


@dataclass(frozen=True, slots=True)
class _Compared:
    """A measured time beside its limit.

    Attributes:
        what: Name of the time, and of the statistic.
        measured: Measured value, s.
        limit: Limit, s.
        lateness: Same statistic of a bare timer in the same run, s.
    """

    what: str
    measured: float
    limit: float
    lateness: float

    @property
    def is_judged(self) -> bool:
        """True if the machine itself kept the limit: beyond that, the limit and the lateness would permit anything."""
        return self.lateness <= self.limit


@dataclass
class Found:
    """Measurements, s and rad.

    Attributes:
        times: Times by name.
        moved: Largest displacement of a joint after each confirmed Stop.
        beyond: Largest motion of a joint beyond its braking distance before standstill, for each braking.
        pressed: Number of presses by motion and route.
        moving: Number of presses during which the arm moved.
        wrong: Descriptions of what is wrong.
        notes: Numbers of other incidents.
    """

    times: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    moved: list[float] = field(default_factory=list)
    beyond: list[float] = field(default_factory=list)
    pressed: Counter[str] = field(default_factory=Counter)
    moving: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    notes: Counter[str] = field(default_factory=Counter)

    def add(self, other: Found) -> None:
        """Add the measurements of another result."""
        for name, values in other.times.items():
            self.times[name] += values
        self.moved += other.moved
        self.beyond += other.beyond
        self.pressed += other.pressed
        self.moving += other.moving
        self.wrong += other.wrong
        self.notes += other.notes

    def late(self, timer: Sequence[float]) -> list[str]:
        """Return descriptions of the times above their limits; `timer` is the lateness of a bare timer meanwhile, s."""
        return [
            f"{each.what} {1e3 * each.measured:.1f} ms, limit {1e3 * each.limit:g} ms and the bare timer's "
            f"{1e3 * each.lateness:.1f} ms."
            for each in self._compared(timer)
            if each.measured > each.limit + each.lateness
        ]

    def not_judged(self, timer: Sequence[float]) -> list[str]:
        """Return descriptions of the limits that mean nothing, because a bare timer was later than the limit itself."""
        return [
            f"{each.what} {1e3 * each.measured:.1f} ms: the machine was too busy, a bare timer was "
            f"{1e3 * each.lateness:.1f} ms late, limit {1e3 * each.limit:g} ms."
            for each in self._compared(timer)
            if not each.is_judged
        ]

    def _compared(self, timer: Sequence[float]) -> Iterator[_Compared]:
        for name, values in self.times.items():
            flood = name.removeprefix(DURING)
            limits = LIMITS.get(name, {}) if flood == name else DURING_FLOODS
            measured, lateness = stats(values, 1.0), stats(self.times.get(f"{TIMER}{flood}", timer), 1.0)
            for which, limit in limits.items():
                yield _Compared(f"{name}: {which}", measured[which], limit, lateness[which])

    def report(self) -> dict[str, Any]:
        """Return the results for JSON: milliseconds and degrees."""
        return {
            "ms": {name: stats(values, 1e3) for name, values in self.times.items()},
            "moved after confirmed, deg": stats(np.degrees(self.moved).tolist(), 1.0),
            "beyond the braking distance, deg": stats(np.degrees(self.beyond).tolist(), 1.0),
            "pressed": dict(sorted(self.pressed.items())),
            "moving": dict(sorted(self.moving.items())),
            "notes": dict(self.notes),
            "wrong": self.wrong,
        }


def stats(values: Sequence[float], scale: float) -> dict[str, float]:
    """Return number, median, 99th percentile and maximum of values.

    Args:
        values: Values.
        scale: Factor for the result.
    """
    shares = {"p50": 0.5, "p99": 0.99}
    found = {name: round(percentile(values, share) * scale, 6) for name, share in shares.items()}
    return {"n": len(values), **found, "max": round(max(values, default=0.0) * scale, 6)}


def farthest(base: Floats, later: Iterable[Floats]) -> float:
    """Return the largest displacement of a joint, rad.

    Args:
        base: Joint positions, rad, (n,).
        later: Later joint positions, rad, (n,).
    """
    return max((float(np.abs(each - base).max()) for each in later), default=0.0)
