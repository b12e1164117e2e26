"""Impairment of a link: messages are lost, doubled, late, out of order, or one way only; seeded."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Literal

__all__ = ["NetworkImpairment"]


@dataclass
class NetworkImpairment:
    """Behaviour of a link, equal for both directions unless one is cut; it may change while in use.

    Attributes:
        seed: Seed of everything that is random.
        loss: Share of the datagrams that never arrive.
        doubled: Share of the datagrams that arrive twice.
        delay: Delay of every message, s.
        jitter: Further delay, uniform between 0 and this, s; a later message may arrive earlier.
        rate: Bytes per second that pass; None for no limit.
        towards: True if messages pass to the server.
        back: True if messages pass back from the server.
        passed: Bytes of streams that have passed, by direction.
        counted: Datagrams by what happened to them.
    """

    seed: int = 0
    loss: float = 0.0
    doubled: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    rate: float | None = None
    towards: bool = True
    back: bool = True
    passed: dict[str, int] = field(default_factory=lambda: {"towards": 0, "back": 0})
    counted: dict[str, int] = field(default_factory=lambda: {"sent": 0, "lost": 0, "doubled": 0, "overtaken": 0})

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._latest = 0.0

    @property
    def narrow(self) -> float | None:
        """Limit of the rate in force, bytes/s; None for no limit."""
        return self.rate

    def passes(self, direction: Literal["towards", "back"]) -> bool:
        """Return whether messages pass in this direction.

        Args:
            direction: ``towards`` the server, or ``back`` from it.
        """
        return self.towards if direction == "towards" else self.back

    def delays(self, now: float) -> list[float]:
        """Return the delays of the copies of a datagram, s: none if it is lost, two if it is doubled.

        Args:
            now: Time at which it is sent, s.
        """
        self.counted["sent"] += 1
        if self._random.random() < self.loss:
            self.counted["lost"] += 1
            return []
        copies = 2 if self._random.random() < self.doubled else 1
        self.counted["doubled"] += copies - 1
        return [self.wait(now) for _ in range(copies)]

    def wait(self, now: float) -> float:
        """Return the delay of a message that arrives, s.

        Args:
            now: Time at which it is sent, s.
        """
        delay = self.delay + self.jitter * self._random.random()
        self.counted["overtaken"] += now + delay < self._latest
        self._latest = max(self._latest, now + delay)
        return delay
