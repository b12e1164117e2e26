"""Tracked poses as they arrive: checked, stored for some seconds, and averaged on demand."""

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
"""Number of frames that are stored per body: more than four seconds at 60 Hz."""

RATE_TIME = 1.0
"""Time over which the frame rate is measured, s of the clock."""

SESSIONS = 64
"""Number of earlier sessions that are remembered: no frame is late by more restarts of the tracker."""

NO_LIMITS = PoseLimits()


@dataclass(frozen=True, slots=True)
class Sighting:
    """An accepted pose.

    Attributes:
        frame_number: Frame number of the tracker; continues across sessions of the tracker.
        exposed: Time of the exposure, s of the tracker's clock.
        captured: Time of the exposure, s of this process's clock.
        tracker_from_body: Pose of the body in the tracker frame.
        session: Session of the tracker; time stamps of two sessions cannot be compared.
    """

    frame_number: int
    exposed: float
    captured: float
    tracker_from_body: Transform
    session: str = ""

    def __reduce__(self) -> tuple[type[Sighting], tuple[int, float, float, Transform, str]]:
        # In a fifth of the time that a dataclass with slots takes: hundreds are sent to the planning process.
        return Sighting, (self.frame_number, self.exposed, self.captured, self.tracker_from_body, self.session)


@dataclass(frozen=True, slots=True)
class FeedContents:
    """Contents of a feed at one moment, for a feed in another process.

    Attributes:
        sightings: Newest accepted poses of each body, oldest first.
        reasons: Reason for which the newest pose of a body was rejected, by body.
        trouble: See `PoseFeed`.
    """

    sightings: dict[str, tuple[Sighting, ...]]
    reasons: dict[str, str]
    trouble: str


class PoseFeed:
    """The newest poses of all tracked bodies.

    A pose is rejected if it is flagged invalid, is not a pose, fits badly, or belongs to an earlier session of the
    tracker, if its frame number or time stamp does not advance within its session, if its time stamp is ahead of the
    others, or if the body has jumped.

    Args:
        clock: Clock of the cell.
        max_age: Age beyond which a pose is stale, s.
        limits: Limits beyond which a pose is rejected.

    Attributes:
        dropped: Number of rejected poses by reason.
        trouble: Reason why the tracker sends nothing, as its node reports it; empty while it sends. Refusals name it.
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
        """Take one pose from the tracker, or count the reason why it is rejected."""
        sighting, reason = self._sighting_of(pose)
        if sighting is None:
            self.dropped[reason] += 1
            self._last_reason[pose.body] = reason
            return
        self._last_reason.pop(pose.body, None)
        self._sightings.setdefault(pose.body, deque(maxlen=HISTORY)).append(sighting)
        self._arrived.set()

    def seen_lately(self, count: int) -> FeedContents:
        """Return the present contents, with at most `count` frames per body."""
        sightings = {body: tuple(known)[-count:] for body, known in self._sightings.items()}
        return FeedContents(sightings, dict(self._last_reason), self.trouble)

    def show(self, seen: FeedContents) -> None:
        """Take over the contents of another feed, whose clock must show the same time."""
        self._sightings = {body: deque(known, maxlen=HISTORY) for body, known in seen.sightings.items()}
        self._last_reason, self.trouble = dict(seen.reasons), seen.trouble

    def newest(self, body: str) -> Transform:
        """Return ``tracker_from_body`` of the newest frame.

        Raises:
            RefusalError: The body was never seen, or its newest pose is stale.
        """
        return self._newest(body).tracker_from_body

    def last_seen(self, body: str) -> float:
        """Return the time of the newest pose of a body, s of the clock; minus infinity if there is none."""
        known = self._sightings.get(body)
        return known[-1].captured if known else -math.inf

    def seen(self, body: str) -> bool:
        """Return True if there is a fresh pose of the body."""
        try:
            self._newest(body)
        except RefusalError:
            return False
        return True

    def rate_hz(self, body: str) -> float:
        """Return the rate of recent frames that show the body, 1/s; it falls if the tracker slows down."""
        since = self._clock.monotonic() - RATE_TIME
        return sum(sighting.captured >= since for sighting in self._sightings.get(body, ())) / RATE_TIME

    def recent(self, bodies: Sequence[str], count: int, since: float) -> dict[str, Transform]:
        """Return ``tracker_from_body`` of each body, averaged over the last frames that show all of them.

        Args:
            bodies: Names of the bodies.
            count: Number of frames to average at most.
            since: Only frames captured after this time, s of the clock.

        Raises:
            RefusalError: The pose of a body is missing or stale, or no frame shows all bodies.
        """
        for body in bodies:
            self._newest(body)
        frames = self.together(bodies, since)[-count:]
        if not frames:
            text = f"{' and '.join(bodies)} have not been seen together since the arm came to rest: ask again."
            raise RefusalError("pose_missing", text)
        return {body: mean_transform([frame[body] for frame in frames]) for body in bodies}

    def together(self, bodies: Sequence[str], since: float) -> list[dict[str, Transform]]:
        """Return the frames that show all bodies, oldest first: ``tracker_from_body`` by body.

        Args:
            bodies: Names of the bodies.
            since: Only frames captured after this time, s of the clock.
        """
        found: dict[int, dict[str, Transform]] = {}
        for body in bodies:
            for sighting in takewhile(lambda each: each.captured >= since, reversed(self._sightings.get(body, ()))):
                found.setdefault(sighting.frame_number, {})[body] = sighting.tracker_from_body
        return [frame for _, frame in sorted(found.items()) if len(frame) == len(bodies)]

    def frames_after(self, number: int, bodies: Sequence[str]) -> list[dict[str, Sighting]]:
        """Return the frames that show all bodies, oldest first: `Sighting` by body.

        Args:
            number: Only frames with a higher frame number.
            bodies: Names of the bodies.
        """
        found: dict[int, dict[str, Sighting]] = {}
        for body in bodies:
            for sighting in takewhile(lambda each: each.frame_number > number, reversed(self._sightings.get(body, ()))):
                found.setdefault(sighting.frame_number, {})[body] = sighting
        return [frame for _, frame in sorted(found.items()) if len(frame) == len(bodies)]

    async def collect(self, bodies: Sequence[str], count: int, timeout: float) -> list[dict[str, Transform]]:
        """Wait for frames that show all bodies and are captured from now on: ``tracker_from_body`` by body.

        Args:
            bodies: Names of the bodies.
            count: Number of frames.
            timeout: Longest wait, s of the clock.

        Raises:
            RefusalError: The frames did not come in time; the text names the bodies that are not seen, and why.
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
        late = self._lateness.update(pose.sent, now)
        try:
            tracker_from_body = Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
        except GeometryError:
            return None, "no_pose"
        rejection = self._jumps.rejection_reason(pose.body, pose.captured, tracker_from_body)
        if rejection:
            return None, rejection
        self._number = max(self._number, number)
        return Sighting(number, pose.captured, now - age - late, tracker_from_body, pose.session), ""

    def _follow_session(self, session: str) -> bool:
        """Forget all poses if a new session begins; return False for a frame of an earlier session."""
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
        """Return True if a time stamp does not advance.

        If `AGREED` stamps in a row are far behind the newest one, the newest one is wrong: it came first, so there was
        no other that it could be ahead of. It is forgotten then, and this returns False.
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
        """Forget the poses of all bodies: the tracker may have been moved, and its clock may be another one."""
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
        if self.trouble:  # the reasons of single poses are outdated then
            reasons = [self.trouble.rstrip(".")]
        return f" ({', '.join(reasons)})" if reasons else ""
