"""A tracker whose poses come from ROS 2."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import structlog

from pcmrs.bus import Bus
from pcmrs.clock import Clock
from pcmrs.devices.plus.frames import FrameAssembler
from pcmrs.devices.plus.messages import Reading
from pcmrs.devices.stream import Stream
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.messages import BodyPose
from pcmrs.ros2._poses import stamp_of, tracker_from_body
from pcmrs.ros2.cdr import PoseStamped, decode
from pcmrs.ros2.topics import tracker_key

SILENCE = 1.0
"""After so long without a frame, stamps may restart, s."""
TOGETHER_WITHIN = 0.005
"""The poses of one stamp arrive back to back; a pose that is later than this was left out, s."""
LOG_PERIOD = 10.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Accepted:
    """Requirements on a pose.

    Attributes:
        names: Body to the last part of its topic.
        frame: Its ``frame_id``.
        max_age: Largest age at arrival, s.
        latency: Time from exposure to arrival to assume if a stamp is ahead of this machine's clock, s.
    """

    names: Mapping[str, str]
    frame: str
    max_age: float
    latency: float


class Ros2Tracker:
    """Implementation of `pcmrs.devices.protocols.TrackerDriver`; while no poses come there are no frames.

    Poses of one stamp are one frame. A refused pose is invalid in that frame, with the reason; if its stamp
    is refused, there is no frame either.

    Args:
        accepted: Requirements on poses.
        clock: Clock that stamps the frames.

    Attributes:
        trouble: Reason why there are no frames; empty while there are.
    """

    def __init__(self, accepted: Accepted, clock: Clock) -> None:
        self._accepted = accepted
        self._clock = clock
        self._frames = FrameAssembler({name: body for body, name in accepted.names.items()}, accepted.latency)
        self._stream: Stream[Sequence[BodyPose]] = Stream()
        self._received: asyncio.Queue[tuple[str, PoseStamped]] = asyncio.Queue()
        self._next_log = clock.monotonic()
        topics = ", ".join(f"/tracker/{name}" for name in accepted.names.values())
        self._no_poses = (
            f"No poses come from ROS 2 on {topics}. Start zenoh-bridge-ros2dds and the node that publishes them."
        )
        self.trouble = self._no_poses

    def listen(self, bus: Bus) -> None:
        """Subscribe to the topics."""
        for name in self._accepted.names.values():
            bus.subscribe_encoded(
                tracker_key(name),
                partial(decode, kind=PoseStamped),
                lambda _, message, name=name: self._received.put_nowait((name, message)),  # type: ignore[misc]
                lambda _, error: self._log_refusal(error),
            )

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        return self._stream.read()

    def close(self) -> None:
        """End all readers."""
        self._stream.close()

    async def run(self) -> None:
        """Make frames of the received poses, until cancelled."""
        while True:
            waiting = self._frames.waiting
            try:
                async with self._clock.timeout(TOGETHER_WITHIN if waiting else SILENCE):
                    name, message = await self._received.get()
            except TimeoutError:
                if waiting:
                    self._publish([self._frames.finish(self._clock.monotonic())])
                else:
                    self._frames.restart()
                    self.trouble = self.trouble or self._no_poses
            else:
                self._take(name, message)

    def _take(self, name: str, message: PoseStamped) -> None:
        now, wall = self._clock.monotonic(), self._clock.wall()
        try:
            reading = self._reading(message, wall)
        except RefusalError as refusal:
            self._log_refusal(refusal)
            return
        self._publish(self._frames.take({name: reading}, stamp_of(message), now, wall))

    def _reading(self, message: PoseStamped, wall: float) -> Reading:
        """Return the pose, or the code of its refusal.

        Raises:
            RefusalError: Not even the stamp can be used.
        """
        accepted = self._accepted
        try:
            return tracker_from_body(message, accepted.frame, wall, accepted.max_age)
        except RefusalError as refusal:
            if refusal.refusal_code.startswith("stamp"):
                raise
            self._log_refusal(refusal)
            return refusal.refusal_code

    def _publish(self, frames: Sequence[Sequence[BodyPose]]) -> None:
        for frame in frames:
            if any(pose.valid for pose in frame):
                self.trouble = ""
            self._stream.publish(frame)

    def _log_refusal(self, error: PcmrsError) -> None:
        """Store the reason, and log it at most once per `LOG_PERIOD`."""
        self.trouble = error.text
        now = self._clock.monotonic()
        if now >= self._next_log:
            self._next_log = now + LOG_PERIOD
            log.warning("ros2_pose_refused", reason=error.text)
