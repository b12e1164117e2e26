"""The queue of messages to be recorded: in order, with relative keys, and bounded."""

from __future__ import annotations

from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from pcmrs.bus import Bus, BusSettings
from pcmrs.clock import SystemClock
from pcmrs.errors import BusError
from pcmrs.messages import DeviceEvent
from pcmrs.recording import subscriber as subscriber_module
from pcmrs.recording.subscriber import RawSample, Subscriber
from pcmrs.testing.clock import ManualClock
from pcmrs.testing.daemon import free_port
from pcmrs.testing.waiting import wait_until
from tests.unit.recording.recording_bench import pose

PREFIX = "pcmrs/lab/cell1"


def sample(key: str, payload: bytes = b"") -> Any:
    """A message as Zenoh hands it over."""
    return SimpleNamespace(key_expr=f"{PREFIX}/{key}", payload=SimpleNamespace(to_bytes=lambda: payload))


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def queue(clock: ManualClock) -> Subscriber:
    """A subscriber without a bus, to which the test hands messages."""
    return Subscriber(cast(zenoh.Session, None), PREFIX, clock)


async def test_messages_are_taken_once_in_order_with_their_arrival(queue: Subscriber, clock: ManualClock) -> None:
    started = clock.monotonic()
    queue._receive(sample("state/fsm", b"1"))
    await clock.advance(0.25)
    queue._receive(sample("state/pose/coil", b"2"))
    assert queue.take() == [RawSample("state/fsm", b"1", started), RawSample("state/pose/coil", b"2", started + 0.25)]
    assert queue.take() == []


def test_full_queue_keeps_the_oldest_and_counts_the_rest(queue: Subscriber, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscriber_module, "CAPACITY", 3)
    for number in range(5):
        queue._receive(sample("state/fsm", bytes([number])))
    assert ([each.payload[0] for each in queue.take()], queue.dropped) == ([0, 1, 2], 2)
    queue._receive(sample("state/fsm", b"\x05"))
    assert [each.payload[0] for each in queue.take()] == [5], "there is room again"


async def test_without_a_key_nothing_is_reported(queue: Subscriber) -> None:
    """It would be refused by the daemon, whose events only its own processes may send."""
    await queue.report(DeviceEvent(device="recorder", code="recording_ended", text="Full."))


@pytest.fixture
async def router() -> AsyncIterator[tuple[Bus, BusSettings]]:
    settings = BusSettings(mode="router", endpoint=f"tcp/127.0.0.1:{free_port()}", site="test", cell="recorded")
    bus = await Bus.open(settings)
    yield bus, BusSettings(endpoint=settings.endpoint, site="test", cell="recorded")
    await bus.close()


async def test_only_subscribed_keys_are_received(router: tuple[Bus, BusSettings]) -> None:
    bus, settings = router
    subscriber = await Subscriber.open(settings, ["state/pose/*"], SystemClock())
    received: list[RawSample] = []

    def arrived() -> bool:
        bus.publish("state/joints", pose("coil"))
        bus.publish("state/pose/coil", pose("coil"))
        received.extend(subscriber.take())
        return len(received) >= 3

    try:
        await wait_until(arrived)
    finally:
        await subscriber.close()
    assert {each.key for each in received} == {"state/pose/coil"}
    assert [each.at for each in received] == sorted(each.at for each in received)


async def test_a_bus_that_does_not_answer_is_an_error() -> None:
    with pytest.raises(BusError):
        await Subscriber.open(BusSettings(endpoint=f"tcp/127.0.0.1:{free_port()}"), ["state/fsm"], SystemClock())
