"""A tracker whose poses ROS 2 measures."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import structlog

from pcmrs.bus import Bus
from pcmrs.clock import Clock
from pcmrs.devices.plus.frames import Frames
from pcmrs.devices.plus.messages import Reading
from pcmrs.devices.stream import Stream
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.messages import BodyPose
from pcmrs.ros2.cdr import PoseStamped, decode
from pcmrs.ros2.poses import stamp_of, tracker_from_body
from pcmrs.ros2.topics import tracker_key

SILENCE = 1.0
"""Without a frame for so long, stamps may begin anew, s."""
TOGETHER_WITHIN = 0.005
"""The poses of one stamp come back to back; what has not come after so long was left out, s."""
LOG_PERIOD = 10.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Accepted:
    """What a pose has to be.

    Attributes:
        names: Body to the last part of its topic.
        frame: Its ``frame_id``.
        max_age: When it comes, s.
        latency: From exposure to arrival where a stamp is ahead of our clock, s.
    """

    names: Mapping[str, str]
    frame: str
    max_age: float
    latency: float


class Ros2Tracker:
    """Implements `pcmrs.devices.protocols.TrackerDriver`; while nothing comes there are no frames.

    Poses of one stamp are one frame. What cannot be accepted is no pose of that frame, with its reason; where the stamp
    itself is refused there is no frame either.

    Args:
        accepted: What is taken.
        clock: Stamps the frames.

    Attributes:
        trouble: Why there are no frames; empty while there are.
    """

    def __init__(self, accepted: Accepted, clock: Clock) -> None:
        self._accepted = accepted
        self._clock = clock
        self._frames = Frames({name: body for body, name in accepted.names.items()}, accepted.latency)
        self._stream: Stream[Sequence[BodyPose]] = Stream()
        self._came: asyncio.Queue[tuple[str, PoseStamped]] = asyncio.Queue()
        self._next_log = clock.monotonic()
        topics = ", ".join(f"/tracker/{name}" for name in accepted.names.values())
        self._nothing = f"No poses come from ROS 2 on {topics}. Start zenoh-bridge-ros2dds and what publishes them."
        self.trouble = self._nothing

    def listen(self, bus: Bus) -> None:
        """Hear the topics from now on."""
        for name in self._accepted.names.values():
            bus.hear(
                tracker_key(name),
                partial(decode, kind=PoseStamped),
                lambda _, message, name=name: self._came.put_nowait((name, message)),  # type: ignore[misc]
                lambda _, error: self._complain(error),
            )

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        return self._stream.read()

    def close(self) -> None:
        """End all readers."""
        self._stream.close()

    async def run(self) -> None:
        """Make frames of what comes, until cancelled."""
        while True:
            waiting = self._frames.waiting
            try:
                async with self._clock.timeout(TOGETHER_WITHIN if waiting else SILENCE):
                    name, message = await self._came.get()
            except TimeoutError:
                if waiting:
                    self._publish([self._frames.finish(self._clock.monotonic())])
                else:
                    self._frames.restart()
                    self.trouble = self.trouble or self._nothing
            else:
                self._take(name, message)

    def _take(self, name: str, message: PoseStamped) -> None:
        now, wall = self._clock.monotonic(), self._clock.wall()
        try:
            reading = self._reading(message, wall)
        except RefusalError as refusal:
            self._complain(refusal)
            return
        self._publish(self._frames.take({name: reading}, stamp_of(message), now, wall))

    def _reading(self, message: PoseStamped, wall: float) -> Reading:
        """Raise `RefusalError` where not even the stamp can be used."""
        accepted = self._accepted
        try:
            return tracker_from_body(message, accepted.frame, wall, accepted.max_age)
        except RefusalError as refusal:
            if refusal.refusal_code.startswith("stamp"):
                raise
            self._complain(refusal)
            return refusal.refusal_code

    def _publish(self, frames: Sequence[Sequence[BodyPose]]) -> None:
        for frame in frames:
            if any(pose.valid for pose in frame):
                self.trouble = ""
            self._stream.publish(frame)

    def _complain(self, error: PcmrsError) -> None:
        """Keep what is wrong, and logs it at most once per `LOG_PERIOD`."""
        self.trouble = error.text
        now = self._clock.monotonic()
        if now >= self._next_log:
            self._next_log = now + LOG_PERIOD
            log.warning("ros2_pose_refused", reason=error.text)
