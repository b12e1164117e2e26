"""Items wait in a queue with bounds, and every key has its turn."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus._fair_queue import FairQueue

EACH, KEYS = 3, 4


def taken(queue: FairQueue[tuple[str, int]]) -> list[tuple[str, int]]:
    found = []
    while (item := queue.take()) is not None:
        found.append(item)
    return found


@given(st.lists(st.sampled_from("abcdef"), max_size=40))
def test_bounded_queue_serves_keys_in_turn_and_in_order(keys: list[str]) -> None:
    queue: FairQueue[tuple[str, int]] = FairQueue(EACH, KEYS)
    added = [(key, number) for number, key in enumerate(keys) if queue.put(key, (key, number))]
    waiting = Counter(key for key, _ in added)
    first = list(dict.fromkeys(keys))[:KEYS]

    assert waiting == {key: min(keys.count(key), EACH) for key in first}
    assert len(queue) == len(added)
    rounds = [[key for key in first if waiting[key] > number] for number in range(EACH)]
    found = taken(queue)
    assert [key for key, _ in found] == [key for each in rounds for key in each]
    assert all(
        [item for item in found if item[0] == key] == [item for item in added if item[0] == key] for key in first
    )
    assert len(queue) == 0


def test_key_of_a_flood_waits_for_the_others() -> None:
    queue: FairQueue[str] = FairQueue(EACH, KEYS)
    for number in range(EACH):
        queue.put("flood", f"flood {number}")
    assert queue.take() == "flood 0"
    queue.put("other", "other")
    queue.put("flood", "flood 3")

    assert [queue.take() for _ in range(4)] == ["flood 1", "other", "flood 2", "flood 3"]


def test_cleared_queue_takes_new_items() -> None:
    queue: FairQueue[int] = FairQueue(1, 1)
    assert queue.put("a", 1)
    assert not queue.put("a", 2)
    assert not queue.put("b", 3)
    queue.clear()

    assert queue.put("b", 3)
    assert queue.take() == 3
    assert queue.take() is None
