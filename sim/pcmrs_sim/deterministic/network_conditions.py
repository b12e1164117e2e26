"""What is wrong with a simulated network now."""

from __future__ import annotations

import random
from dataclasses import dataclass, field


@dataclass
class NetworkConditions:
    """How messages fare between any two endpoints.

    Attributes:
        delay: Longest extra delay of a message, s; each gets a part of it.
        loss: Part of the messages that are lost; of requests and their answers, too: those who ask hear nothing.
        duplicates: Part of the published messages and datagrams that arrive twice.
        reordering: Part of the published messages and datagrams that let later ones overtake them.
        cut: Pairs (from, to) between which nothing passes; one direction each.
    """

    delay: float = 0.0
    loss: float = 0.0
    duplicates: float = 0.0
    reordering: float = 0.0
    cut: set[tuple[str, str]] = field(default_factory=set)

    @property
    def fine(self) -> bool:
        """Whether nothing is wrong."""
        return not (self.delay or self.loss or self.duplicates or self.reordering or self.cut)

    def partition(self, one: str, other: str, *, both: bool = True) -> None:
        """Lets nothing pass from `one` to `other`, nor back if `both`."""
        self.cut.add((one, other))
        if both:
            self.cut.add((other, one))

    def heal(self) -> None:
        """Everything is well again."""
        self.delay = self.loss = self.duplicates = self.reordering = 0.0
        self.cut.clear()

    def lost(self, source: str, target: str, draw: random.Random) -> bool:
        """Whether a message does not arrive."""
        return (source, target) in self.cut or bool(self.loss and draw.random() < self.loss)
