"""Presses of Stop that meet a Stop under way: they are that Stop, and are counted.

As long as the hold of a Stop is not answered, nothing can release the latch, and a further press would ask for what is
being done already. Nobody may delay the loop, or fill the journal, by pressing without end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

SOURCES: Final = 32
"""Sources of one kind, such as all of the bus, with their own Stop under way; one more joins the newest Stop, and is
counted by its name there."""
NAMED: Final = 32
"""Names that one Stop counts by; further ones are counted together."""
OTHERS: Final = "others"


@dataclass(eq=False, slots=True)
class StopUnderWay:
    """One Stop.

    Attributes:
        source: Who has pressed.
        number: Of the Stop.
        standing: Its result is whether the robot has confirmed that it stands.
        joined: Source to its presses that have met this Stop.
    """

    source: str
    number: int
    standing: asyncio.Task[bool]
    joined: dict[str, int] = field(default_factory=dict)

    def join(self, source: str, presses: int) -> None:
        """Counts presses."""
        name = source if source in self.joined or len(self.joined) < NAMED else OTHERS
        self.joined[name] = self.joined.get(name, 0) + presses


class Presses:
    """The Stops under way, by who has pressed.

    Args:
        joined: Called with a Stop that others have joined, once it is not under way any more.
    """

    def __init__(self, joined: Callable[[StopUnderWay], object]) -> None:
        self._joined = joined
        self._under_way: dict[str, StopUnderWay] = {}

    def find(self, source: str) -> StopUnderWay | None:
        """The Stop under way that a press by `source` is; None where it begins one."""
        own = self._under_way.get(source)
        if own is None and sum(_kind(each) == _kind(source) for each in self._under_way) >= SOURCES:
            return next(reversed(self._under_way.values()))
        return own

    def add(self, stop: StopUnderWay, holding: asyncio.Future[bool]) -> None:
        """A Stop has begun; it is under way until `holding` is done."""
        self._under_way.pop(stop.source, None)  # the newest comes last
        self._under_way[stop.source] = stop
        holding.add_done_callback(lambda _: self._end(stop))

    def _end(self, stop: StopUnderWay) -> None:
        if self._under_way.get(stop.source) is stop:
            del self._under_way[stop.source]
        if stop.joined:
            self._joined(stop)


def _kind(source: str) -> str:
    """By which way a source presses, such as ``bus`` or ``udp``: nobody on one of them takes the places of others."""
    return source.partition(":")[0]
