"""Drive of a cabinet without the servo option: point-to-point motions, one segment at a time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.kst.connection import SPEEDS, KstConnection
from pcmrs.devices.kst.drive import Drive
from pcmrs.devices.kst.settings import KstSettings
from pcmrs.devices.motion.follower import brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.segments import MotionSegment, SegmentFollower
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent, JointState
from pcmrs.spatial import Floats

READING_PERIOD = 0.01
"""Time between two looks at a moving arm, s: each reply of the cabinet is taken and the next reading requested."""


class SegmentDrive(Drive):
    """Motion of the arm from one end of a segment to the next; see `Drive` for the arguments.

    The cabinet says when a segment has ended, so the arm settles sooner than after a stream. During a segment, joints
    and torques are read by requests that the cabinet always answers. They carry the segment's goal, which is the
    cabinet's present target anyway.
    """

    settling = 0.15

    def __init__(
        self,
        cabinet: KstConnection,
        posture: Floats,
        settings: KstSettings,
        model: ArmModel,
        force: ForceSettings,
        clock: Clock,
        publish: Callable[[JointState], None],
        report: Callable[[DeviceEvent], None],
    ) -> None:
        super().__init__(cabinet, posture, settings, model, force, clock, publish, report)
        limits = brake_limits(model.facts, settings.brake_acceleration, settings.brake_jerk)
        self._segments = SegmentFollower(model, limits, force, self.arm.force, posture, self._step)
        self.follower = self._segments

    async def _move(self) -> None:
        self._reply, self._ended_at, self._deviated = None, np.inf, False
        while (segment := self._segments.next) is not None:
            await self._cabinet.prepare_ptp(segment.goal, float(np.clip(segment.speed, *SPEEDS)))
            # Nothing is awaited between this look and the command: the motion may have been held meanwhile.
            if self._segments.next is segment:
                self._segments.take()
                await self._perform(segment)
        await self._come_to_rest()

    async def _perform(self, segment: MotionSegment) -> None:
        """Move to the end of a segment, whatever happens: the cabinet cannot stop it."""
        self.arm.begin()
        self.arm.add_set_point(segment.goal, self._clock.monotonic())
        ended = await self._cabinet.start_ptp(segment.duration)
        while not ended.done() or self._reply is not None:
            self._cabinet.check()
            self._take_reply()
            self._segments.supervise()
            self._report_alarms()
            if self._reply is None and not ended.done():
                self._request_reading(segment.goal)
            await self._clock.sleep(READING_PERIOD)
        self._cabinet.check_ended(ended)

    def _request_reading(self, goal: Floats) -> None:
        request, self._take = next(self._requests)
        self._requested_at = self._clock.monotonic()
        self._reply = request(goal)

    async def _come_to_rest(self) -> None:
        """Return when the arm is measured at rest at the end of its last segment."""
        while not self._at_rest():
            self._check_settles()
            await self._poll(0.0)
            self._segments.supervise()
            self._report_alarms()
            await self._clock.sleep(2 * READING_PERIOD)
