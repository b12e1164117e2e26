"""Tracked poses as they arrive: guarded, kept for a moment, and averaged on demand."""

from __future__ import annotations

import asyncio
import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

from pcmrs.clock import Clock
from pcmrs.devices.jumps import JumpGuard, PoseLimits
from pcmrs.devices.lateness import Lateness
from pcmrs.errors import GeometryError, RefusalError
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform, mean_transform

HISTORY = 256
"""Frames kept per body: over four seconds at 60 Hz."""

RATE_TIME = 1.0
"""Over so long a time the rate of frames is taken, s of the clock."""

RESTART_TIME = 2.0
"""A tracker that begins to count anew after so long a silence was restarted, s of the clock."""


NO_LIMITS = PoseLimits()


@dataclass(frozen=True, slots=True)
class Sighting:
    """A valid pose.

    Attributes:
        exposed: When it was captured, s of the tracker's clock.
        captured: The same, s of this process's clock.
    """

    frame_number: int
    exposed: float
    captured: float
    tracker_from_body: Transform


class PoseFeed:
    """The newest poses of all tracked bodies.

    A pose is not taken when it is flagged invalid, is no pose, fits badly, its frame number or stamp does not
    advance, or the body has jumped; what was dropped is counted by reason in `dropped`.

    Args:
        clock: The cell's clock.
        max_age: Age beyond which a pose is stale, s.
        limits: Beyond which a pose is not believed.

    Attributes:
        trouble: Why the tracker sends nothing, as its node says; empty while it does. Refusals tell it.
    """

    def __init__(self, clock: Clock, max_age: float, limits: PoseLimits = NO_LIMITS) -> None:
        self.dropped: Counter[str] = Counter()
        self.trouble = ""
        self._clock = clock
        self._max_age = max_age
        self._limits = limits
        self._jumps = JumpGuard(limits)
        self._lateness = Lateness()
        self._sightings: dict[str, deque[Sighting]] = {}
        self._arrivals: dict[str, float] = {}
        self._last_reason: dict[str, str] = {}
        self._arrived = asyncio.Event()

    def update(self, pose: BodyPose) -> None:
        """Takes one pose from the tracker, or counts why not."""
        sighting, reason = self._sighting_of(pose)
        if sighting is None:
            self.dropped[reason] += 1
            self._last_reason[pose.body] = reason
            return
        self._last_reason.pop(pose.body, None)
        self._sightings.setdefault(pose.body, deque(maxlen=HISTORY)).append(sighting)
        self._arrived.set()

    def newest(self, body: str) -> Transform:
        """``tracker_from_body`` of the newest frame.

        Raises:
            RefusalError: The body has not been seen, or not lately.
        """
        return self._newest(body).tracker_from_body

    def seen(self, body: str) -> bool:
        """Whether there is a fresh pose of the body."""
        try:
            self._newest(body)
        except RefusalError:
            return False
        return True

    def rate_hz(self, body: str) -> float:
        """Frames per second that showed the body lately; a tracker that slows down is seen here."""
        since = self._clock.monotonic() - RATE_TIME
        return sum(sighting.captured >= since for sighting in self._sightings.get(body, ())) / RATE_TIME

    def recent(self, bodies: Sequence[str], count: int, since: float) -> dict[str, Transform]:
        """Means over the last `count` frames captured after `since` that show all `bodies`.

        Raises:
            RefusalError: A body is not seen freshly, or the bodies are not seen together.
        """
        for body in bodies:
            self._newest(body)
        frames = self.together(bodies, since)[-count:]
        if not frames:
            text = f"{' and '.join(bodies)} have not been seen together since the arm came to rest: ask again."
            raise RefusalError("pose_missing", text)
        return {body: mean_transform([frame[body] for frame in frames]) for body in bodies}

    def together(self, bodies: Sequence[str], since: float) -> list[dict[str, Transform]]:
        """The frames captured after `since`, s of the clock, that show all `bodies`: ``tracker_from_body`` each."""
        found: dict[int, dict[str, Transform]] = {}
        for body in bodies:
            for sighting in takewhile(lambda each: each.captured >= since, reversed(self._sightings.get(body, ()))):
                found.setdefault(sighting.frame_number, {})[body] = sighting.tracker_from_body
        return [frame for _, frame in sorted(found.items()) if len(frame) == len(bodies)]

    def frames_after(self, number: int, bodies: Sequence[str]) -> list[dict[str, Sighting]]:
        """The frames after frame `number` that show all `bodies`, oldest first, each with its stamps."""
        found: dict[int, dict[str, Sighting]] = {}
        for body in bodies:
            for sighting in takewhile(lambda each: each.frame_number > number, reversed(self._sightings.get(body, ()))):
                found.setdefault(sighting.frame_number, {})[body] = sighting
        return [frame for _, frame in sorted(found.items()) if len(frame) == len(bodies)]

    async def collect(self, bodies: Sequence[str], count: int, timeout: float) -> list[dict[str, Transform]]:
        """`count` frames captured from now on that show all `bodies`: ``tracker_from_body`` each.

        Raises:
            RefusalError: They did not come within `timeout` s: which body is not seen, and why.
        """
        begin = self._clock.monotonic()
        frames: list[dict[str, Transform]] = []
        try:
            async with self._clock.timeout(timeout):
                while len(frames) < count:
                    self._arrived.clear()
                    frames = self.together(bodies, begin)
                    if len(frames) < count:
                        await self._arrived.wait()
        except TimeoutError:
            text = f"{len(frames)} of {count} frames that show {' and '.join(bodies)} came within {timeout:g} s"
            why = self._why_missing(bodies)
            raise RefusalError("pose_missing", f"{text}{why}.", seen=len(frames), wanted=count) from None
        return frames[:count]

    def _sighting_of(self, pose: BodyPose) -> tuple[Sighting | None, str]:
        if not pose.valid:
            return None, pose.reason or "invalid"
        if not pose.error <= self._limits.error:
            return None, "fit_error"
        age = pose.sent - pose.captured
        if not 0.0 <= age < math.inf:
            return None, "stamp_reversed"
        now = self._clock.monotonic()
        silence, self._arrivals[pose.body] = now - self._arrivals.get(pose.body, now), now
        known = self._sightings.get(pose.body)
        if known and pose.frame_number < known[-1].frame_number and silence > RESTART_TIME:
            self._forget()  # the tracker was restarted and counts anew; a frozen one repeats its number
        late = self._lateness.hear(pose.sent, now)
        if known and pose.frame_number <= known[-1].frame_number:
            return None, "frame_not_advancing"
        if known and pose.captured <= known[-1].exposed:
            return None, "stamp_not_advancing"
        try:
            tracker_from_body = Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
        except GeometryError:
            return None, "no_pose"
        doubt = self._jumps.doubt(pose.body, pose.captured, tracker_from_body)
        if doubt:
            return None, doubt
        return Sighting(pose.frame_number, pose.captured, now - age - late, tracker_from_body), ""

    def _forget(self) -> None:
        """Of every body: a number of before would name another frame now."""
        self._lateness.forget()
        for body, sightings in self._sightings.items():
            self._jumps.forget(body)
            sightings.clear()

    def _newest(self, body: str) -> Sighting:
        known = self._sightings.get(body)
        if not known:
            raise RefusalError("pose_missing", f"{body} has not been seen{self._why_missing([body])}.", body=body)
        age = self._clock.monotonic() - known[-1].captured
        if age > self._max_age:
            text = f"The newest pose of {body} is {age:.3f} s old, the limit is {self._max_age:.3f} s"
            text += f"{self._why_missing([body])}. Clear the line of sight."
            raise RefusalError("pose_stale", text, body=body, age=age, limit=self._max_age)
        return known[-1]

    def _why_missing(self, bodies: Sequence[str]) -> str:
        reasons = [f"{body}: {self._last_reason[body]}" for body in bodies if body in self._last_reason]
        if self.trouble:  # then the others are of old
            reasons = [self.trouble.rstrip(".")]
        return f" ({', '.join(reasons)})" if reasons else ""
