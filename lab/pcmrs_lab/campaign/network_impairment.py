"""What happens to messages on their way: lost, doubled, late, out of order, one way only; seeded."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Literal

from pcmrs_lab.campaign.sham import is_sham


@dataclass
class NetworkImpairment:
    """How a link behaves, for each direction alike unless it is cut; may be changed while it is in use.

    Attributes:
        seed: Of everything that is random.
        loss: Share of the datagrams that never arrive.
        doubled: Share of the datagrams that arrive twice.
        delay: Of everything, s.
        jitter: Further delay, even between 0 and this, s: what is sent later may arrive earlier.
        rate: Bytes per second that get through; None for all.
        towards: Whether anything gets to the server.
        back: Whether anything gets back from it.
        passed: Bytes of streams that have got through, by direction.
        counted: Datagrams by what became of them.
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
        """`rate`; in a sham campaign everything gets through."""
        return None if is_sham() else self.rate

    def passes(self, direction: Literal["towards", "back"]) -> bool:
        """Whether anything gets through in this direction; in a sham campaign it does."""
        return is_sham() or (self.towards if direction == "towards" else self.back)

    def delays(self, now: float) -> list[float]:
        """After how many seconds a datagram of this moment arrives: never when it is lost, twice when it is doubled."""
        self.counted["sent"] += 1
        if is_sham():
            return [0.0]
        if self._random.random() < self.loss:
            self.counted["lost"] += 1
            return []
        copies = 2 if self._random.random() < self.doubled else 1
        self.counted["doubled"] += copies - 1
        return [self.wait(now) for _ in range(copies)]

    def wait(self, now: float) -> float:
        """How long what is sent at this moment takes, s, if it arrives."""
        delay = 0.0 if is_sham() else self.delay + self.jitter * self._random.random()
        self.counted["overtaken"] += now + delay < self._latest
        self._latest = max(self._latest, now + delay)
        return delay
