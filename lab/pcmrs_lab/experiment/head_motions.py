"""Motions of a simulated head in the following experiment."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.messages import HeadBurst, HeadMotion, HeadStep

DRIFT, DRIFT_TIME = 0.060, 1800.0
"""Drift of a head in half an hour, m and s."""
STEP = 0.005
"""Offset of a head that shifts, m."""
BURST_SPEED, BURST_TIME = 0.086, 0.4
"""Speed and duration of quick voluntary motion, m/s and s."""
BREATHING, BREATHING_HZ = 0.002, 0.25
"""Amplitude, m, and frequency, Hz, of the motion by breathing."""
EVERY = 5.0
"""Time between two steps or two bursts, s."""

Direction = tuple[float, float, float]
ALONG: tuple[Direction, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Scenario:
    """Kind of motion for one run."""

    name: str
    text: str
    motion: HeadMotion


def scenarios(duration: float, seed: int) -> list[Scenario]:
    """Return all kinds of motion; except for the drift, the head returns each time.

    Args:
        duration: Duration of a run, s.
        seed: Seed of the irregular motions.
    """
    x, _, z = ALONG
    times = [EVERY * (number + 0.2) for number in range(int(duration / EVERY))]
    steps = [HeadStep(time=time, offset=_along(number, STEP)) for number, time in enumerate(times)]
    bursts = [
        HeadBurst(time=time, duration=BURST_TIME, speed=BURST_SPEED, direction=_along(number, 1.0))
        for number, time in enumerate(times)
    ]
    return [
        Scenario("still", "a head at rest", HeadMotion()),
        Scenario(
            "breathing",
            f"{BREATHING * 1000:g} mm at {BREATHING_HZ:g} Hz",
            HeadMotion(breathing_amplitude=BREATHING, breathing_hz=BREATHING_HZ, breathing_direction=z, seed=seed),
        ),
        Scenario("steps", f"{STEP * 1000:g} mm in 0.1 s, every {EVERY:g} s", HeadMotion(steps=steps)),
        Scenario(
            "bursts", f"{BURST_SPEED * 1000:g} mm/s for {BURST_TIME:g} s, every {EVERY:g} s", HeadMotion(bursts=bursts)
        ),
        Scenario(
            "drift",
            f"{DRIFT * 1000:g} mm in {duration:g} s: {DRIFT_TIME / duration:.0f} times as fast as in half an hour",
            HeadMotion(drift=(DRIFT / duration * x[0], 0.0, 0.0)),
        ),
    ]


def _along(number: int, length: float) -> Direction:
    """Return an offset to and fro along one axis of the tracker after the other."""
    x, y, z = ALONG[number // 2 % len(ALONG)]
    signed = length if number % 2 == 0 else -length
    return signed * x, signed * y, signed * z
