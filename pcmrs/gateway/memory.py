"""Outcomes by peer and id, so that a repeated command runs nothing, even after its session is forgotten."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from pcmrs.gateway.outcome import Outcome

MAX_REMEMBERED = 10_000
"""Outcomes kept, of all peers together; of older commands the daemon still recalls those that it performed."""


class Memory:
    """Remembers what commands with an id came to, and which are under way."""

    def __init__(self) -> None:
        self._outcomes: OrderedDict[tuple[str, str], asyncio.Future[Outcome]] = OrderedDict()

    def recall(self, source: str, client_id: str) -> asyncio.Future[Outcome] | None:
        """The outcome, there or to come, of the command that `source` sent with this id; None for a new one."""
        return self._outcomes.get((source, client_id))

    def keep(self, source: str, client_id: str, ended: asyncio.Future[Outcome]) -> None:
        """Remembers a command; beyond `MAX_REMEMBERED` the oldest is forgotten, unless it is under way."""
        self._outcomes[source, client_id] = ended
        if len(self._outcomes) > MAX_REMEMBERED:
            key, oldest = next(iter(self._outcomes.items()))
            if oldest.done():
                del self._outcomes[key]
            else:
                self._outcomes.move_to_end(key)
