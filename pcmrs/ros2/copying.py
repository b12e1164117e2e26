"""Republishes the state of a cell for ROS 2: a client of the bus that subscribes there and publishes there."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any

import structlog

from pcmrs.bus import Bus, BusSettings
from pcmrs.clock import SystemClock
from pcmrs.errors import GeometryError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.messages import BodyPose, JointState, Snapshot, Target
from pcmrs.recording.frame_tree import FrameTree
from pcmrs.ros2._views import RosMessage, Views
from pcmrs.ros2.topics import TOPICS, Topic
from pcmrs.workflows.mounting import Mounting

log = structlog.get_logger(__name__)

COMPONENT = "ros2"
LOG_PERIOD = 10.0


async def copy_for_ros2(
    settings: BusSettings, arm: ArmFacts, mounting: Mounting, rate: float, ended: asyncio.Event
) -> dict[str, int]:
    """Subscribe to a cell and publish its state for ROS 2, until `ended` is set.

    Args:
        settings: Settings of the bus.
        arm: Arm of the cell.
        mounting: Calibrated poses of what the arm carries.
        rate: Seconds of the cell per second of the machine.
        ended: Ends it.

    Returns:
        Topic to the number of messages published there.

    Raises:
        BusError: No daemon answers at the endpoint.
    """
    clock = SystemClock(rate)
    views = Views([joint.name for joint in arm.joints], FrameTree(arm, mounting), mounting, clock, rate)
    bus = await Bus.open(settings)
    try:
        bus.alive(COMPONENT)
        copier = _Copier(bus, clock)
        for topic in TOPICS:
            copier.announce(topic)
        copier.publish([views.fixed()])
        bus.subscribe("state/target", Target, lambda _, target: views.target(target))
        copier.copy("state/joints", JointState, views.joints)
        copier.copy("state/pose/*", BodyPose, views.pose)
        copier.copy("state/fsm", Snapshot, views.snapshot)
        await ended.wait()
        return copier.counts
    finally:
        await bus.close()


class _Copier:
    def __init__(self, bus: Bus, clock: SystemClock) -> None:
        self._bus = bus
        self._clock = clock
        self._next_log = clock.monotonic()
        self.counts: dict[str, int] = {}

    def announce(self, topic: Topic) -> None:
        self.counts[topic.name] = 0
        self._bus.announce(topic.token)

    def copy(self, key: str, kind: type[Any], view: Callable[[Any], Iterable[RosMessage]]) -> None:
        def take(received: str, message: Any) -> None:
            try:
                self.publish(view(message))
            except GeometryError as error:
                self._log_refusal(received, error.text)

        self._bus.subscribe(key, kind, take)

    def publish(self, messages: Iterable[RosMessage]) -> None:
        for topic, message in messages:
            if topic.name not in self.counts:
                self.announce(topic)
            self._bus.publish_cdr(topic.key, message.serialize())
            self.counts[topic.name] += 1

    def _log_refusal(self, key: str, why: str) -> None:
        now = self._clock.monotonic()
        if now >= self._next_log:
            self._next_log = now + LOG_PERIOD
            log.warning("not_copied", key=key, reason=why)
