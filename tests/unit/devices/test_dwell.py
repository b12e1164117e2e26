"""A touch is a tip that is held still."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import numpy.typing as npt
import pytest

from pcmrs.devices.dwell import DwellPointer, DwellSettings
from pcmrs.devices.poses import PoseFeed
from pcmrs.messages import BodyPose, LandmarkPrompt
from pcmrs.spatial import Transform
from pcmrs.testing.clock import ManualClock, settle

PERIOD = 1 / 60
LATENCY = 0.03
MAX_AGE = 0.25
SETTINGS = DwellSettings(time=0.5, still_mm=1.0, samples=10, away_mm=10.0)
TIP = Transform.from_quat_wxyz((0.0, 0.0, -0.15), (1.0, 0.0, 0.0, 0.0))
PROMPT = LandmarkPrompt(index=0, name="nasion", position_in_image=(0.0, 0.0, 0.0))
OTHER = LandmarkPrompt(index=1, name="tragus", position_in_image=(0.0, 0.1, 0.0))
TABLE, NASION, TRAGUS = (0.0, 0.5, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0)


class Hand:
    """Holds the tip at places in body_ref, while the head moves."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.feed = PoseFeed(self.clock, MAX_AGE)
        self.pointer = DwellPointer(self.feed, self.clock, TIP, SETTINGS)
        self.asked: asyncio.Task[None] | None = None
        self._number = 0
        self._noise = np.random.default_rng(1)

    async def ask(self, prompt: LandmarkPrompt = PROMPT) -> None:
        self.asked = asyncio.create_task(self.pointer.touch(prompt))
        await settle()

    async def rest(self, tip: npt.ArrayLike, seconds: float, noise_mm: float = 0.05) -> None:
        for _ in range(round(seconds / PERIOD)):
            await self.frame(np.array(tip) + self._noise.normal(0.0, noise_mm * 1e-3, 3))

    async def go(self, start: npt.ArrayLike, end: npt.ArrayLike, seconds: float) -> None:
        for part in np.linspace(0.0, 1.0, round(seconds / PERIOD)):
            await self.frame((1.0 - part) * np.array(start) + part * np.array(end))

    async def frame(self, tip: npt.NDArray[np.float64], seen: bool = True) -> None:
        self.publish(tip, seen)
        await self.clock.advance(PERIOD)

    def publish(self, tip: npt.NDArray[np.float64], seen: bool = True) -> None:
        self._number += 1
        head = Transform.from_rotvec((0.001 * self._number, 0.0, -1.0), (0.0, 0.001 * self._number, 0.0))
        turned = Transform.from_rotvec(tip, (0.2 * np.sin(self._number / 9), 0.0, 0.0))  # about the tip
        self._publish("body_ref", head, True)
        self._publish("pointer", head @ turned @ TIP.inverse(), seen)

    def _publish(self, body: str, pose: Transform, seen: bool) -> None:
        now = self.clock.monotonic()
        x, y, z = pose.translation.tolist()
        w, i, j, k = pose.quat_wxyz.tolist()
        self.feed.update(
            BodyPose(
                body=body,
                frame_number=self._number,
                captured=now - LATENCY,
                sent=now,
                valid=seen,
                position=(x, y, z),
                quat_wxyz=(w, i, j, k),
            )
        )

    @property
    def done(self) -> bool:
        return self.asked is not None and self.asked.done()


@pytest.fixture
async def hand() -> AsyncIterator[Hand]:
    hand = Hand()
    yield hand
    if hand.asked is not None:
        hand.asked.cancel()
        await asyncio.gather(hand.asked, return_exceptions=True)


async def test_a_tip_held_still_is_a_touch_after_the_dwell_time(hand: Hand) -> None:
    await hand.rest(TABLE, 1.0)
    await hand.ask()
    await hand.go(TABLE, NASION, 0.5)
    await hand.rest(NASION, SETTINGS.time - 2 * PERIOD)
    assert not hand.done
    await hand.rest(NASION, 0.2)
    assert hand.done


async def test_a_resting_tip_counts_at_the_first_prompt(hand: Hand) -> None:
    await hand.rest(NASION, 5.0)
    await hand.ask()
    await hand.rest(NASION, SETTINGS.time - 2 * PERIOD)
    assert not hand.done, "what was before the prompt does not count"
    await hand.rest(NASION, 0.2)
    assert hand.done


async def test_a_landmark_is_touched_again_without_lifting_the_tip(hand: Hand) -> None:
    await hand.ask()
    await hand.rest(NASION, 1.0)
    assert hand.done
    await hand.pointer.release()
    await hand.ask()
    await hand.rest(NASION, SETTINGS.time + 0.2)
    assert hand.done


async def test_one_resting_tip_is_never_two_landmarks(hand: Hand) -> None:
    await hand.ask()
    await hand.rest(NASION, 1.0)
    assert hand.done
    await hand.pointer.release()
    await hand.ask(OTHER)
    await hand.rest(NASION, 3.0)
    assert not hand.done
    await hand.go(NASION, TRAGUS, 0.5)
    await hand.rest(TRAGUS, 1.0)
    assert hand.done


@pytest.mark.parametrize("millimetres", [5.0, 9.0])
async def test_another_landmark_needs_the_whole_way(hand: Hand, millimetres: float) -> None:
    await hand.ask()
    await hand.rest(NASION, 1.0)
    near = (NASION[0] + millimetres * 1e-3, 0.0, 0.0)
    await hand.ask(OTHER)
    await hand.go(NASION, near, 0.2)
    await hand.rest(near, 3.0)
    assert not hand.done


async def test_a_rest_before_the_prompt_is_no_touch(hand: Hand) -> None:
    """The tip is away from the last touch already, but nobody has said yet that it is where it should be."""
    await hand.ask()
    await hand.rest(NASION, 1.0)
    await hand.go(NASION, TRAGUS, 0.5)
    await hand.rest(TRAGUS, 2.0)
    await hand.ask(OTHER)
    await hand.rest(TRAGUS, SETTINGS.time - 2 * PERIOD)
    assert not hand.done
    await hand.rest(TRAGUS, 0.2)
    assert hand.done


async def test_the_same_place_is_touched_again_after_lifting_the_tip(hand: Hand) -> None:
    await hand.ask()
    await hand.rest(NASION, 1.0)
    lifted = (0.1, 0.0, 0.015)
    await hand.ask(OTHER)
    await hand.go(NASION, lifted, 0.2)
    await hand.go(lifted, NASION, 0.2)
    await hand.rest(NASION, 1.0)
    assert hand.done


async def test_a_tip_that_reappears_at_the_last_landmark_is_no_other(hand: Hand) -> None:
    await hand.ask()
    await hand.rest(NASION, 1.0)
    await hand.ask(OTHER)
    for _ in range(30):
        await hand.frame(np.array(NASION), seen=False)
    await hand.rest(NASION, 2.0)
    assert not hand.done


@pytest.mark.parametrize("noise_mm", [2.0, 5.0])
async def test_a_trembling_hand_is_no_touch(hand: Hand, noise_mm: float) -> None:
    await hand.ask()
    await hand.rest(NASION, 3.0, noise_mm)
    assert not hand.done
    await hand.rest(NASION, 1.0)
    assert hand.done


async def test_a_tip_that_slides_is_no_touch(hand: Hand) -> None:
    await hand.ask()
    await hand.go(NASION, TRAGUS, 10.0)  # 14 mm/s
    assert not hand.done


async def test_rarely_seen_pointer_is_a_touch_after_enough_sightings(hand: Hand) -> None:
    await hand.ask()
    for _ in range(5):  # what is captured before the prompt does not count
        await hand.frame(np.array(NASION), seen=False)
    for sighting in range(SETTINGS.samples):
        assert not hand.done, f"seen {sighting} times"
        for number in range(10):
            await hand.frame(np.array(NASION), seen=number == 0)
    assert hand.done


async def test_surface_touch_works_alike_and_a_wait_can_be_cancelled(hand: Hand) -> None:
    hand.asked = asyncio.create_task(hand.pointer.touch_surface())
    await settle()
    await hand.rest(NASION, 1.0)
    assert hand.done
    await hand.ask()
    assert hand.asked is not None
    hand.asked.cancel()
    with pytest.raises(asyncio.CancelledError):
        await hand.asked


async def test_a_rest_that_is_learnt_of_too_late_is_no_touch(hand: Hand) -> None:
    """A link that was held up brings its frames at once: where the tip is now, they do not say."""
    await hand.rest(TABLE, 1.0)
    await hand.ask()
    await hand.go(TABLE, NASION, 0.5)
    for _ in range(round(2.0 * SETTINGS.time / PERIOD)):
        hand.clock.stall(PERIOD)
        hand.publish(np.array(NASION))
    hand.clock.stall(2.0 * MAX_AGE)
    await hand.clock.advance(PERIOD)
    assert not hand.done
    await hand.rest(NASION, SETTINGS.time + 0.2)
    assert hand.done
