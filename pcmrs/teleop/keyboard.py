"""The keyboard of a terminal. It reports no release: a key counts as held for as long as it repeats."""

from __future__ import annotations

import asyncio
import os
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from pcmrs.errors import ConfigurationError
from pcmrs.messages.teleop import AT_REST, Twist
from pcmrs.teleop.demand import Demand, Mapping

AXES = {
    **{"d": (0, 1.0), "a": (0, -1.0), "w": (1, 1.0), "s": (1, -1.0), "r": (2, 1.0), "f": (2, -1.0)},
    **{"k": (3, 1.0), "i": (3, -1.0), "l": (4, 1.0), "j": (4, -1.0), "o": (5, 1.0), "u": (5, -1.0)},
}
"""Key to axis (x, y, z, about x, y, z) and direction."""
STOP, LEAVE = " ", ("q", "\x1b", "\x03", "\x04")

HELP = "a d, w s, f r: along x, y, z (r: away from the body)   i k, j l, u o: about them   space: Stop   q: leave"

HELD = 0.15
"""A key counts as held for so long after its last character, s: longer than a repeat, about 33 ms."""
CLUTCH_HELD = 1.0
"""The clutch stays closed for so long after a key, s: longer than the pause before the first repeat, which is about
half a second. The tool stands still meanwhile."""


class Keys:
    """The demand of keys: the last pressed key moves the tool while it is held; there is no other clutch.

    Args:
        mapping: Converts deflections to a twist; a key is full deflection.
    """

    def __init__(self, mapping: Mapping) -> None:
        self._mapping = mapping
        self._key, self._pressed = "", float("-inf")
        self._stop = self._leave = False

    def press(self, key: str, now: float) -> None:
        """Take a key, first pressed or repeated.

        Args:
            key: Character of the key.
            now: Time in s of the monotonic clock.
        """
        if key in AXES:
            self._key, self._pressed = key, now
        elif key == STOP:
            self._stop = True
        elif key in LEAVE:
            self._leave = True
        else:
            self._pressed = float("-inf")  # a wrong key must stop the motion, not continue it

    def demand(self, now: float) -> Demand:
        stop, self._stop = self._stop, False
        if stop:
            self._pressed = float("-inf")
        since = now - self._pressed
        return Demand(self._twist() if since < HELD else AT_REST, since < CLUTCH_HELD, stop, self._leave)

    def _twist(self) -> Twist:
        deflection = [0.0] * 6
        axis, direction = AXES[self._key]
        deflection[axis] = direction
        return self._mapping.twist(deflection)


@contextmanager
def open_keyboard(mapping: Mapping) -> Iterator[Keys]:
    """Read the keys of the terminal one by one, in the running event loop; afterwards the terminal is restored.

    Raises:
        ConfigurationError: Standard input is not a terminal.
    """
    if not sys.stdin.isatty():
        raise ConfigurationError(
            "The keyboard can only be read from a terminal, and standard input is not one: use --device."
        )
    keys, loop, descriptor = Keys(mapping), asyncio.get_running_loop(), sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)

    def read() -> None:
        text = os.read(descriptor, 1024).decode(errors="replace")
        for key in text or LEAVE[0]:  # a closed terminal always reads as empty
            keys.press(key, loop.time())

    tty.setcbreak(descriptor)
    loop.add_reader(descriptor, read)
    try:
        yield keys
    finally:
        loop.remove_reader(descriptor)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
