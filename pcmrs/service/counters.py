"""What the parts of the daemon have counted, in one table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

Source = Callable[[], Mapping[str, int]]


def counted(sources: Iterable[Source]) -> dict[str, int]:
    """The counters of all parts, each under a name of its own, such as ``bus.refused`` or ``loop.stalls``."""
    return {name: many for source in sources for name, many in source().items()}
