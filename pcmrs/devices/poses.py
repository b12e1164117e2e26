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
from pcmrs.devices.lateness import AGREED, WINDOW, Lateness
from pcmrs.errors import GeometryError, RefusalError
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform, mean_transform

HISTORY = 256
"""Frames kept per body: over four seconds at 60 Hz."""

RATE_TIME = 1.0
"""Over so long a time the rate of frames is taken, s of the clock."""

SESSIONS = 64
"""Earlier sessions that are remembered: a frame may be late, but not by so many starts of the tracker."""

NO_LIMITS = PoseLimits()


@dataclass(frozen=True, slots=True)
class Sighting:
    """A valid pose.

    Attributes:
        frame_number: The tracker's, going on where a new session of the tracker counts anew.
        exposed: When it was captured, s of the tracker's clock.
        captured: The same, s of this process's clock.
        session: That of the tracker; stamps of two sessions cannot be compared.
    """

    frame_number: int
    exposed: float
    captured: float
    tracker_from_body: Transform
    session: str = ""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a feed knew at one moment, for a feed in another process.

    Attributes:
        sightings: The newest of each body, oldest first.
        reasons: Why the newest pose of a body was not taken.
        trouble: See `PoseFeed`.
    """

    sightings: dict[str, tuple[Sighting, ...]]
    reasons: dict[str, str]
    trouble: str


class PoseFeed:
    """The newest poses of all tracked bodies.

    A pose is not taken when it is flagged invalid, is no pose, fits badly, its frame number or stamp does not
    advance within its session, its stamp lies ahead of the others, it is of an earlier session of the tracker, or the
    body has jumped; what was dropped is counted by reason in `dropped`.

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
        self._session: str | None = None
        self._earlier: deque[str] = deque(maxlen=SESSIONS)
        self._number = self._offset = 0
        self._behind: dict[str, int] = {}
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

    def seen_lately(self, count: int) -> Seen:
        """Return what is known now, with at most `count` frames per body."""
        sightings = {body: tuple(known)[-count:] for body, known in self._sightings.items()}
        return Seen(sightings, dict(self._last_reason), self.trouble)

    def show(self, seen: Seen) -> None:
        """Knows from now on what another feed knew; its clock must show the same time."""
        self._sightings = {body: deque(known, maxlen=HISTORY) for body, known in seen.sightings.items()}
        self._last_reason, self.trouble = dict(seen.reasons), seen.trouble

    def newest(self, body: str) -> Transform:
        """``tracker_from_body`` of the newest frame.

        Raises:
            RefusalError: The body has not been seen, or not lately.
        """
        return self._newest(body).tracker_from_body

    def last_seen(self, body: str) -> float:
        """Return when the newest pose of a body was captured, s of the clock; minus infinity where there is none."""
        known = self._sightings.get(body)
        return known[-1].captured if known else -math.inf

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
        if not self._follow_session(pose.session):
            return None, "earlier_session"
        if not pose.valid:
            return None, pose.reason or "invalid"
        if not pose.error <= self._limits.error:
            return None, "fit_error"
        age = pose.sent - pose.captured
        if not 0.0 <= age < math.inf:
            return None, "stamp_reversed"
        now, known = self._clock.monotonic(), self._sightings.get(pose.body)
        number = self._offset + pose.frame_number
        if known and number <= known[-1].frame_number:
            return None, "frame_not_advancing"
        if self._lateness.is_ahead(pose.sent, now):
            return None, "stamp_ahead"
        if known and self._is_behind(pose, known[-1]):
            return None, "stamp_not_advancing"
        late = self._lateness.hear(pose.sent, now)
        try:
            tracker_from_body = Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
        except GeometryError:
            return None, "no_pose"
        doubt = self._jumps.doubt(pose.body, pose.captured, tracker_from_body)
        if doubt:
            return None, doubt
        self._number = max(self._number, number)
        return Sighting(number, pose.captured, now - age - late, tracker_from_body, pose.session), ""

    def _follow_session(self, session: str) -> bool:
        """Forgets all poses where a new session begins; returns False for a frame of an earlier one."""
        if session == self._session:
            return True
        if session in self._earlier:
            return False
        if self._session is not None:
            self._earlier.append(self._session)
            self._forget()
        self._session = session
        return True

    def _is_behind(self, pose: BodyPose, newest: Sighting) -> bool:
        """Whether a stamp does not advance; not where so many are so far behind that the newest one must be wrong.

        That one has come first of all: there was nothing that it could be ahead of.
        """
        if pose.captured > newest.exposed:
            self._behind.pop(pose.body, None)
            return False
        is_far = newest.exposed - pose.captured > WINDOW
        self._behind[pose.body] = self._behind.get(pose.body, 0) + 1 if is_far else 0
        if self._behind[pose.body] < AGREED:
            return True
        self._lateness.forget()
        self._jumps.forget(pose.body)
        self._sightings[pose.body].clear()
        del self._behind[pose.body]
        return False

    def _forget(self) -> None:
        """Of every body: the tracker may stand elsewhere, and its clock may be another one."""
        self._lateness.forget()
        self._behind.clear()
        self._offset = self._number + 1
        self._jumps.forget_all()
        for sightings in self._sightings.values():
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
