"""A pointer without electronics: its tip touches where it is held still."""

from __future__ import annotations

from itertools import takewhile
from typing import Annotated

import msgspec
import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.poses import PoseFeed, Sighting
from pcmrs.messages import LandmarkPrompt
from pcmrs.spatial import Floats, Transform

Positive = Annotated[float, msgspec.Meta(gt=0.0)]

LOOK_PERIOD = 0.02
"""Time between two looks at the newest frames, s of the clock."""

BODIES = ("body_ref", "pointer")
"""Tracked bodies that a frame must show."""


class DwellSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Conditions under which a tip that is held still is a touch.

    Attributes:
        time: Time for which the tip is held still, s; well within the stored history of poses.
        still_mm: Greatest distance of the tip from its present position in that time, mm.
        samples: Least number of frames that show the tip there.
        away_mm: Before the touch of another landmark, the tip must have been farther than this from the last touch, mm.
    """

    time: Annotated[float, msgspec.Meta(gt=0.0, le=3.0)] = 0.8
    still_mm: Positive = 1.0
    samples: Annotated[int, msgspec.Meta(ge=2)] = 10
    away_mm: Positive = 10.0


class DwellPointer:
    """A tracked stylus, watched in the daemon's own poses; implements `pcmrs.devices.protocols.Pointer`.

    A touch waits without a limit: the caller has the deadline and cancels it. A tip that already rests where it should
    be need not be lifted: it counts once it has been held there for the whole time after the prompt. Only for another
    landmark than that of the last touch it must have been away, so that one resting tip is never two landmarks.

    Args:
        poses: Poses of pointer and body_ref.
        clock: Clock of the cell.
        pointer_from_tip: Pose of the tip in the pointer's marker body; only its translation matters.
        settings: Conditions of a touch.
    """

    def __init__(self, poses: PoseFeed, clock: Clock, pointer_from_tip: Transform, settings: DwellSettings) -> None:
        self._poses = poses
        self._clock = clock
        self._tip_in_pointer = pointer_from_tip.translation
        self._settings = settings
        self._last: tuple[LandmarkPrompt | None, Floats] | None = None

    async def touch(self, prompt: LandmarkPrompt) -> None:
        await self._wait_until_held(prompt)

    async def touch_surface(self) -> None:
        await self._wait_until_held(None)

    async def slide(self) -> None:
        await self._wait_until_held(None)

    async def release(self) -> None:
        """Do nothing: the next landmark must be elsewhere, or the tip lifted in between."""

    async def _wait_until_held(self, prompt: LandmarkPrompt | None) -> None:
        prompted, left = self._clock.monotonic(), self._departure(prompt)
        away = left is None
        while True:
            await self._clock.sleep(LOOK_PERIOD)
            frames = self._frames(prompted)
            away = away or (bool(frames) and self._is_away(frames[-1], left))
            if away and self._held_still(frames):
                self._last = prompt, self._tip(frames[-1])
                return

    def _departure(self, prompt: LandmarkPrompt | None) -> Floats | None:
        """Return the position that the tip must leave first; None if it may be touching already.

        A point of the skin is never the same as another one.
        """
        if self._last is None or (prompt is not None and prompt == self._last[0]):
            return None
        return self._last[1]

    def _is_away(self, frame: dict[str, Sighting], left: Floats | None) -> bool:
        return left is None or float(np.linalg.norm(self._tip(frame) - left)) > self._settings.away_mm * 1e-3

    def _held_still(self, frames: list[dict[str, Sighting]]) -> bool:
        """Return True if the tip was held where the newest frame shows it, long and often enough."""
        if not frames or not all(self._poses.seen(body) for body in BODIES):
            return False
        newest, limit = self._tip(frames[-1]), self._settings.still_mm * 1e-3
        resting = list(takewhile(lambda each: np.linalg.norm(self._tip(each) - newest) <= limit, reversed(frames)))
        duration = resting[0]["pointer"].captured - resting[-1]["pointer"].captured
        return duration >= self._settings.time and len(resting) >= self._settings.samples

    def _frames(self, since: float) -> list[dict[str, Sighting]]:
        """Return the frames that show pointer and reference together, captured at `since` or later, oldest first."""
        return [frame for frame in self._poses.frames_after(-1, BODIES) if frame["pointer"].captured >= since]

    def _tip(self, frame: dict[str, Sighting]) -> Floats:
        """Return the position of the tip in body_ref, m, (3,)."""
        seen = {body: frame[body].tracker_from_body for body in BODIES}
        tip: Floats = seen["body_ref"].inverse() @ (seen["pointer"] @ self._tip_in_pointer)
        return tip
