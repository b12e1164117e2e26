"""A source is lost when it is silent, sends old frames or too many events, or says that it cannot see."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.messages import SceneEvent
from pcmrs.messages.scene_event import BLIND, WATCHING
from pcmrs.scene.liveness import Liveness
from pcmrs.scene.settings import SceneSourceSettings
from pcmrs.testing.clock import ManualClock

SETTINGS = SceneSourceSettings(silent_after=0.5, returns_after=1.0, rate_hz=10.0)
OFFSET = 1000.0
"""Time by which the source's clock is ahead, s."""


class Source:
    """A source with its own clock."""

    def __init__(self, settings: SceneSourceSettings = SETTINGS) -> None:
        self.clock = ManualClock()
        self.liveness = Liveness(settings, self.clock)
        self.session = "first"
        self.drift = 0.0

    def send(self, *, age: float = 0.0, delay: float = 0.0, label: str = WATCHING, **fields: Any) -> bool:
        """Send a frame of an age that has travelled so long; return whether it counts."""
        sent = self.clock.monotonic() * (1.0 + self.drift) + OFFSET - delay
        event = SceneEvent(source="camera", label=label, captured=sent - age, sent=sent, session=self.session, **fields)
        return self.liveness.take(event)

    async def watch(self, seconds: float) -> None:
        """Send a frame each 0.2 s."""
        for _ in range(round(seconds / 0.2)):
            await self.clock.advance(0.2)
            self.send()
            self.liveness.check()


async def test_silence_is_a_loss_until_frames_have_come_for_some_time() -> None:
    source = Source()
    await source.clock.advance(0.5)
    assert source.liveness.check() is None
    await source.clock.advance(0.1)
    assert source.liveness.check() == "silent", "also if it has never sent anything"
    await source.watch(1.0)
    assert source.liveness.lost == "silent"
    await source.watch(0.4)
    assert source.liveness.lost is None


async def test_frame_that_is_repeated_is_stale() -> None:
    source = Source()
    source.send()
    for number in range(1, 5):
        await source.clock.advance(0.2)
        assert source.send(age=0.2 * number) is (number <= 2)
    assert source.liveness.check() == "stale"


async def test_delay_on_the_way_counts_towards_the_age() -> None:
    source = Source()
    assert source.send(age=0.1, delay=0.02)
    await source.clock.advance(0.4)
    assert source.send(age=0.1, delay=0.12)
    await source.clock.advance(0.4)
    assert not source.send(age=0.1, delay=0.5)


@pytest.mark.parametrize("drift", [-5e-4, 5e-4], ids=["slow", "fast"])
async def test_clock_that_drifts_is_no_delay(drift: float) -> None:
    source = Source()
    source.drift = drift
    await source.watch(1800.0)
    assert source.send(), "0.9 s have come together, which is more than an event may be late"
    assert source.liveness.check() is None


async def test_delay_that_lasts_does_not_become_normal() -> None:
    source = Source()
    await source.watch(1.0)
    for _ in range(900):
        await source.clock.advance(0.2)
        assert not source.send(delay=1.0)
    assert source.liveness.check() == "stale"


async def test_one_event_stamped_ahead_is_dropped_and_counted() -> None:
    source = Source()
    await source.watch(1.0)
    assert not source.send(delay=-5.0)
    assert source.liveness.ahead == 1
    await source.clock.advance(0.2)
    assert source.send(), "it has made no other look late"


async def test_source_whose_first_event_was_late_is_not_lost() -> None:
    source = Source()
    source.send(delay=5.0)
    await source.watch(4.0)
    assert source.send()
    assert source.liveness.check() is None


async def test_frame_from_the_future_or_overtaken_does_not_count() -> None:
    source = Source()
    await source.clock.advance(0.2)
    assert not source.send(age=-0.1)
    assert source.send()
    assert not source.send(age=0.1), "a newer frame was received"


async def test_restarted_source_is_compared_with_itself_only() -> None:
    source = Source()
    source.send()
    source.session = "second"
    await source.clock.advance(0.6)
    assert source.send(age=0.1)


async def test_second_process_is_a_loss_and_shows_nothing() -> None:
    source = Source()
    source.send()
    source.session = "second"
    await source.clock.advance(0.2)
    assert not source.send()
    assert source.liveness.check() == "two_senders"


async def test_second_process_does_not_hide_the_death_of_the_first() -> None:
    source = Source()
    source.send()
    source.session = "second"
    await source.watch(1.6)
    assert source.liveness.lost is not None, "it was two senders, and then one that has yet to send for some time"
    await source.watch(1.0)
    assert source.liveness.lost is None


async def test_sessions_that_alternate_do_not_renew_old_frames() -> None:
    source = Source()
    source.send()
    for number in range(20):
        await source.clock.advance(0.1)
        source.session = ("first", "second")[number % 2]
        assert source.send(delay=1.0) is False
    assert source.liveness.check() is not None


async def test_change_of_session_shows_a_silence_that_nobody_saw() -> None:
    source = Source()
    source.send()
    source.session = "second"
    await source.clock.advance(0.51)
    source.send()
    assert source.liveness.check() == "silent"


async def test_more_events_than_the_rate_are_a_loss() -> None:
    source = Source()
    taken = [source.send() for _ in range(15)]
    assert taken.count(True) == 10
    assert source.liveness.check() == "flooded"


async def test_source_that_cannot_see_says_why() -> None:
    source = Source()
    source.send(label=BLIND, reason="occluded")
    assert source.liveness.check() == "blind"
    assert source.liveness.blind == "occluded"
