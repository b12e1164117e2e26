"""A script in place of a device, for tests and demonstrations: times and twists."""

from __future__ import annotations

import math
from bisect import bisect_right
from pathlib import Path

from pcmrs.errors import ConfigurationError
from pcmrs.messages.teleop import Twist
from pcmrs.teleop.demand import Demand

OPEN = "open"
"""In place of a twist: the clutch is open."""


class TwistScript:
    """Lines with a time and a twist, each valid until the next; the last one ends the script.

    Args:
        lines: Rising times, s from the first demand, with twists, or None for an open clutch.
    """

    def __init__(self, lines: list[tuple[float, Twist | None]]) -> None:
        self._times = [time for time, _ in lines]
        self._twists = [twist for _, twist in lines]
        self._begun: float | None = None

    def demand(self, now: float) -> Demand:
        self._begun = now if self._begun is None else self._begun
        line = bisect_right(self._times, now - self._begun)
        if line == len(self._times):
            return Demand(leave=True)
        twist = self._twists[line - 1] if line else None
        return Demand() if twist is None else Demand(twist, clutch=True)


def read_script(file: Path) -> TwistScript:
    """Return the script in a file.

    Each line is ``time x y z rx ry rz`` in s, m/s and rad/s, or ``time open``; ``#`` begins a remark.

    Raises:
        ConfigurationError: A line is something else, or times do not rise; the text names the line.
    """
    lines: list[tuple[float, Twist | None]] = []
    for number, text in enumerate(_read(file).splitlines(), start=1):
        words = text.partition("#")[0].split()
        if not words:
            continue
        line = _line(words)
        if line is None or (lines and line[0] <= lines[-1][0]):
            fault = f"{file}, line {number}: write a time later than the one before, and six velocities or {OPEN!r}."
            raise ConfigurationError(fault, file=str(file), line=number)
        lines.append(line)
    if not lines:
        raise ConfigurationError(f"{file} has no line of a script.", file=str(file))
    return TwistScript(lines)


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{file} cannot be read: {error}", file=str(file)) from None


def _line(words: list[str]) -> tuple[float, Twist | None] | None:
    try:
        time, *numbers = [float(word) for word in words if word != OPEN]
    except ValueError:
        return None
    if not all(map(math.isfinite, (time, *numbers))) or time < 0.0:
        return None
    if words[1:] == [OPEN]:
        return time, None
    if len(numbers) != 6 or len(words) != 7:
        return None
    x, y, z, rx, ry, rz = numbers
    return time, (x, y, z, rx, ry, rz)
