"""A pointer without electronics: holding its tip still somewhere is the touch."""

from __future__ import annotations

from itertools import takewhile

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.dwelling import DwellSettings
from pcmrs.devices.poses import PoseFeed, Sighting
from pcmrs.messages import LandmarkPrompt
from pcmrs.spatial import Floats, Transform

LOOK_PERIOD = 0.02
"""Time between looks at the newest frames, s of the clock."""

BODIES = ("body_ref", "pointer")


class DwellPointer:
    """A tracked stylus, watched on the daemon's own poses; implements `pcmrs.devices.protocols.Pointer`.

    A touch waits without end: its caller has the deadline and cancels it.

    Args:
        poses: Where pointer and body_ref are seen.
        clock: The cell's clock.
        pointer_from_tip: The tip in the pointer's marker body; only its translation matters.
        settings: How still and how long.
    """

    def __init__(self, poses: PoseFeed, clock: Clock, pointer_from_tip: Transform, settings: DwellSettings) -> None:
        self._poses = poses
        self._clock = clock
        self._tip_in_pointer = pointer_from_tip.translation
        self._settings = settings
        self._last_touch: Floats | None = None

    async def touch(self, prompt: LandmarkPrompt) -> None:  # noqa: ARG002 (the screen shows it)
        await self._wait_until_held()

    async def touch_surface(self) -> None:
        await self._wait_until_held()

    async def release(self) -> None:
        """Nothing to do: the next touch must be elsewhere, or the tip lifted between."""

    async def _wait_until_held(self) -> None:
        prompted = self._clock.monotonic()
        left, away = self._left(), False
        while True:
            await self._clock.sleep(LOOK_PERIOD)
            frames = self._frames(prompted)
            away = away or (bool(frames) and self._is_away(frames[-1], left))
            if away and self._held_still(frames):
                self._last_touch = self._tip(frames[-1])
                return

    def _left(self) -> Floats | None:
        """What the tip must have left: the last touch, or where it was seen last, if at all."""
        if self._last_touch is not None:
            return self._last_touch
        known = self._frames(since=-np.inf)
        return self._tip(known[-1]) if known else None

    def _is_away(self, frame: dict[str, Sighting], left: Floats | None) -> bool:
        return left is None or float(np.linalg.norm(self._tip(frame) - left)) > self._settings.away_mm * 1e-3

    def _held_still(self, frames: list[dict[str, Sighting]]) -> bool:
        """Whether the tip rests where it was in the newest frame, long and often enough."""
        if not frames or not all(self._poses.seen(body) for body in BODIES):
            return False
        newest, limit = self._tip(frames[-1]), self._settings.still_mm * 1e-3
        resting = list(takewhile(lambda each: np.linalg.norm(self._tip(each) - newest) <= limit, reversed(frames)))
        duration = resting[0]["pointer"].captured - resting[-1]["pointer"].captured
        return duration >= self._settings.time and len(resting) >= self._settings.samples

    def _frames(self, since: float) -> list[dict[str, Sighting]]:
        """What shows pointer and reference together, captured after `since`, oldest first."""
        return [frame for frame in self._poses.frames_after(-1, BODIES) if frame["pointer"].captured >= since]

    def _tip(self, frame: dict[str, Sighting]) -> Floats:
        """In body_ref, m, (3,)."""
        seen = {body: frame[body].tracker_from_body for body in BODIES}
        tip: Floats = seen["body_ref"].inverse() @ (seen["pointer"] @ self._tip_in_pointer)
        return tip
