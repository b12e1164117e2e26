"""The simulated optical tracker, which publishes each frame after its latency."""

from __future__ import annotations

from collections import deque
from collections.abc import AsyncIterator, Sequence

import msgspec

from pcmrs.clock import Clock
from pcmrs.devices.stream import Stream
from pcmrs.messages import BodyPose
from pcmrs.spatial import Transform
from pcmrs_sim.error_models import FEWEST_SPHERES, TrackerErrors
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.tracker_faults import BODIES, TrackerFaults
from pcmrs_sim.world import World


class SimTracker:
    """Tracker that measures all bodies at its rate and publishes each frame when it is `latency` old.

    The pose of a body is the rigid fit of its seen spheres. A body with fewer than three is lost.

    It implements `pcmrs.devices.protocols.TrackerDriver`.

    Args:
        world: World with the bodies.
        clock: Clock that stamps published frames.
        start: Time of the first exposure, s of `clock`.

    Attributes:
        newest: Last published frame; empty before the first.
        faults: Present faults.
    """

    def __init__(self, world: World, clock: Clock, start: float) -> None:
        self._world = world
        self._clock = clock
        self._settings = world.settings.tracker
        self._next_exposure = start
        self._frame_number = 0
        self._pending: deque[list[BodyPose]] = deque()
        self._stream: Stream[Sequence[BodyPose]] = Stream()
        self._jitter_free_poses: dict[str, tuple[Transform, TrackerErrors, tuple[bool, ...], BodyPose]] = {}
        self.newest: Sequence[BodyPose] = ()
        self.faults = TrackerFaults()

    @property
    def hidden(self) -> set[str]:
        """Hidden bodies. The set may be changed."""
        return self._world.hidden

    @property
    def trouble(self) -> str:
        return "" if self.faults.sending else "The simulated tracker is switched off by a fault."

    def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        return self._stream.read()

    @property
    def due(self) -> float:
        """Time at which `update` is needed next, s of the clock."""
        pending = self._pending  # in the order of their publication
        return min(self._next_exposure, self._publication(pending[0])) if pending else self._next_exposure

    def update(self, time: float) -> None:
        """Expose and publish the frames that are due at a time, s of the clock."""
        if time >= self._next_exposure:
            self._frame_number += 1
            self._pending.append([self._expose(body, time) for body in BODIES])
        while time >= self._next_exposure:  # a cell that lags skips frames
            self._next_exposure += 1 / (self.faults.rate_hz or self._settings.rate_hz)
        while self._pending and time >= self._publication(self._pending[0]):
            self._publish(self._pending.popleft())

    def close(self) -> None:
        """End all readers."""
        self._stream.close()

    def _publish(self, exposed: Sequence[BodyPose]) -> None:
        if not self.faults.sending:
            return
        sent = self._clock.monotonic()
        frame = [msgspec.structs.replace(pose, sent=sent) for pose in exposed]
        self.newest = self.faults.distort(frame, self.newest)
        self._stream.publish(self.newest)

    def _publication(self, frame: Sequence[BodyPose]) -> float:
        return frame[0].captured + self._settings.latency

    def _expose(self, body: str, time: float) -> BodyPose:
        tracker_from_body = self._world.tracker_from(body)
        if tracker_from_body is None:
            return self._unseen(body, time, "not_visible")
        sight = self._world.observe().sight(body)
        if body in self._world.hidden or sight.inside.sum() >= FEWEST_SPHERES > sight.seen.sum():
            return self._unseen(body, time, "occluded")
        if sight.inside.sum() < FEWEST_SPHERES:
            return self._unseen(body, time, "out_of_volume")
        # Without jitter, a body at rest has the same pose in each frame, which need not be computed again.
        errors, cached, seen = self._world.tracker_errors, self._jitter_free_poses.get(body), tuple(sight.seen.tolist())
        if cached is not None and cached[:3] == (tracker_from_body, errors, seen):
            return msgspec.structs.replace(cached[3], frame_number=self._frame_number, captured=time, sent=time)
        measured, error = errors.measure(tracker_from_body, MARKER_BODIES[body].positions, sight.seen)
        x, y, z = measured.translation.tolist()
        w, i, j, k = measured.quat_wxyz.tolist()
        pose = BodyPose(
            body=body,
            frame_number=self._frame_number,
            captured=time,
            sent=time,
            valid=True,
            position=(x, y, z),
            quat_wxyz=(w, i, j, k),
            error=error,
        )
        if errors.jitter_free:
            self._jitter_free_poses[body] = (tracker_from_body, errors, seen, pose)
        return pose

    def _unseen(self, body: str, time: float, reason: str) -> BodyPose:
        return BodyPose(
            body=body, frame_number=self._frame_number, captured=time, sent=time, valid=False, reason=reason
        )
