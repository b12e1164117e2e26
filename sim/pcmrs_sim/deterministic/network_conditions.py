"""Present disturbances of a simulated network."""

from __future__ import annotations

import random
from dataclasses import dataclass, field


@dataclass
class NetworkConditions:
    """Disturbances of messages between any two endpoints.

    Attributes:
        delay: Longest extra delay of a message, s; each message gets a random part of it.
        loss: Fraction of the messages that are lost. A lost request or reply leaves the requester without an answer.
        duplicates: Fraction of the published messages and datagrams that arrive twice.
        reordering: Fraction of the published messages and datagrams that later ones may overtake.
        cut: Pairs (from, to) between which nothing passes, one direction each.
    """

    delay: float = 0.0
    loss: float = 0.0
    duplicates: float = 0.0
    reordering: float = 0.0
    cut: set[tuple[str, str]] = field(default_factory=set)

    @property
    def undisturbed(self) -> bool:
        """True without any disturbance."""
        return not (self.delay or self.loss or self.duplicates or self.reordering or self.cut)

    def partition(self, one: str, other: str, *, both: bool = True) -> None:
        """Drop everything from one endpoint to another.

        Args:
            one: Name of the sending endpoint.
            other: Name of the receiving endpoint.
            both: Drop the opposite direction, too.
        """
        self.cut.add((one, other))
        if both:
            self.cut.add((other, one))

    def heal(self) -> None:
        """End all disturbances."""
        self.delay = self.loss = self.duplicates = self.reordering = 0.0
        self.cut.clear()

    def lost(self, source: str, target: str, draw: random.Random) -> bool:
        """Return true if a message does not arrive.

        Args:
            source: Name of the sending endpoint.
            target: Name of the receiving endpoint.
            draw: Random numbers of the network.
        """
        return (source, target) in self.cut or bool(self.loss and draw.random() < self.loss)
