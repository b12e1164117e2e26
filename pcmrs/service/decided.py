"""Which commands a journal may have verdicts on, without a look at the disk for all others."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterable


class DecidedKeys:
    """Hashes of the keys of commands, 8 bytes for each that an earlier run has decided: journals hold many.

    What is not in it was never decided. What is in it most probably was: only the journal can say.

    Args:
        earlier: Source and id of the commands that earlier runs have decided.
    """

    def __init__(self, earlier: Iterable[tuple[str, str]]) -> None:
        self._earlier = array("q", sorted(map(hash, earlier)))
        self._since: set[int] = set()

    def add(self, source: str, command_id: str) -> None:
        """Adds a command that is about to be journalled."""
        self._since.add(hash((source, command_id)))

    def __contains__(self, key: tuple[str, str]) -> bool:
        wanted = hash(key)
        place = bisect_left(self._earlier, wanted)
        return wanted in self._since or (place < len(self._earlier) and self._earlier[place] == wanted)
