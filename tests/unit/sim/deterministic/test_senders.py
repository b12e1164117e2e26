"""Threads that send requests: the pool keeps no order, a sender with its own thread does."""

from __future__ import annotations

import asyncio

import msgspec
import pytest

from pcmrs_sim.deterministic.senders import THREADS, Senders, name_of
from pcmrs_sim.deterministic.windows import Windows


class ScriptedWindows(Windows):
    """Windows of given durations, in s, one after the other."""

    def __init__(self, *durations: float) -> None:
        super().__init__(asyncio.new_event_loop(), 1)
        self._loop.close()
        self._durations = list(durations)

    def open(self, name: str) -> float:
        self.opened[name] += 1
        return self._durations.pop(0)


class Order(msgspec.Struct, frozen=True):
    """A request to a device."""

    method: str


class Note(msgspec.Struct, frozen=True):
    """A request without a method."""


def test_requests_of_the_pool_overtake_each_other() -> None:
    senders = Senders(ScriptedWindows(0.4, 0.1))
    assert senders.delay("slow", 10.0) == pytest.approx(0.4)
    assert senders.delay("quick", 10.0) == pytest.approx(0.1)


def test_a_request_waits_when_all_threads_of_the_pool_are_busy() -> None:
    senders = Senders(ScriptedWindows(*[0.2] * THREADS, 0.1, 0.1))
    assert [senders.delay("busy", 10.0) for _ in range(THREADS)] == pytest.approx([0.2] * THREADS)
    assert senders.delay("late", 10.05) == pytest.approx(0.15 + 0.1)
    assert senders.delay("later", 11.0) == pytest.approx(0.1), "all threads are free again"


def test_requests_of_a_sender_with_its_own_thread_keep_order() -> None:
    windows = ScriptedWindows(0.4, 0.1, 0.0)
    senders = Senders(windows)
    assert senders.delay("first", 10.0, "watch") == pytest.approx(0.4)
    assert senders.delay("second", 10.0, "watch") == pytest.approx(0.5)
    assert senders.delay("other", 10.0, "teleop") == 0.0
    assert windows.opened == {"send:first": 1, "send:second": 1, "send:other": 1}


@pytest.mark.parametrize(
    ("key", "message", "name"),
    [
        ("dev/robot/call", Order("follow"), "robot.follow"),
        ("cmd/anna/placement/approach", Note(), "placement.approach"),
        ("query/state", Note(), "query/state"),
    ],
)
def test_a_request_has_the_name_that_scripts_use(key: str, message: msgspec.Struct, name: str) -> None:
    assert name_of(key, message) == name
