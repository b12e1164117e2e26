"""Queue in which every key has its turn, so that nobody waits behind another one's flood."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class FairQueue(Generic[T]):
    """Items by key: those of one key in their order, the keys in turn.

    Its owner guards it by a lock if several threads use it.

    Args:
        each: Number of items that may wait for one key.
        keys: Number of keys for which items may wait.
    """

    def __init__(self, each: int, keys: int) -> None:
        self._each, self._keys = each, keys
        self._waiting: dict[str, deque[T]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def put(self, key: str, item: T) -> bool:
        """Add an item.

        Args:
            key: Key of the item.
            item: The item.

        Returns:
            False if too many items wait for this key, or items for too many keys; the item is not added then.
        """
        waiting = self._waiting.get(key)
        if waiting is None:
            if len(self._waiting) >= self._keys:
                return False
            waiting = self._waiting[key] = deque()
        elif len(waiting) >= self._each:
            return False
        waiting.append(item)
        return True

    def take(self) -> T | None:
        """Remove and return the first item of the key whose turn it is; None if the queue is empty."""
        if not self._waiting:
            return None
        key = next(iter(self._waiting))
        waiting = self._waiting.pop(key)
        item = waiting.popleft()
        if waiting:
            self._waiting[key] = waiting  # at the end: the other keys come first
        return item

    def clear(self) -> None:
        """Drop all items."""
        self._waiting.clear()
