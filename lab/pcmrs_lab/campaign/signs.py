"""Observations of a tracker's fault by a subscriber: the receiver decides whether it happened."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from pcmrs.clock import SystemClock
from pcmrs.messages import BodyPose
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.waiting import until_true

if TYPE_CHECKING:
    from pcmrs.bus import Bus
    from pcmrs.testing.cell import RunningCell

SILENCE = 0.4
"""Time without frames after which a tracker counts as silent, s of the machine; 24 frames."""
WRONG_LENGTH = 0.1
BAD_FIT = 2e-3  # m
LEAP = 0.01
"""No body here moves this far from one frame to the next, m: that is 0.6 m/s."""
FUTURE = 1.0  # s
SLOW = 0.15
"""Time between two frames, s of the tracker's clock; at 60 a second they are 0.017 s apart."""
DASH = 0.05
"""Speed of a head that dashes, m/s."""

Sign = Callable[[BodyPose, BodyPose, dict[str, Any]], bool]
"""Returns whether a frame shows the fault, from the body's frame before it, the frame, and the fault's arguments."""


def _leaps(last: BodyPose, pose: BodyPose, _: dict[str, Any]) -> bool:
    return last.valid and pose.valid and math.dist(last.position, pose.position) > LEAP


def _dashes(last: BodyPose, pose: BodyPose, _: dict[str, Any]) -> bool:
    between = pose.captured - last.captured
    return last.valid and pose.valid and between > 0.0 and math.dist(last.position, pose.position) > DASH * between


SIGNS: dict[str, Sign] = {
    "occlude": lambda _last, pose, _: not pose.valid,
    "frame_frozen": lambda last, pose, _: pose.frame_number == last.frame_number,
    "pose_not_unit": lambda _last, pose, _: abs(math.hypot(*pose.quat_wxyz) - 1.0) > WRONG_LENGTH,
    "pose_jump": _leaps,
    "not_measured": lambda _last, pose, arguments: not pose.valid and pose.reason == arguments["reason"],
    "bad_fit": lambda _last, pose, _: pose.error > BAD_FIT,
    "phantom_marker": _leaps,
    "tool_swap": _leaps,
    "wrong_tool": lambda _last, pose, _: not pose.valid and pose.reason == "wrong_tool",
    "tracker_rate": lambda last, pose, _: pose.captured - last.captured > SLOW,
    "stamp_reversed": lambda last, pose, _: pose.captured < last.captured,
    "stamp_future": lambda _last, pose, _: pose.captured > pose.sent + FUTURE,
    "dash_head": _dashes,
}
"""Signs by the name of the fault; not `tracker_absent`, of which no frame comes, and `pose_nan`, which no bus accepts.
"""


class ReceivedPoses:
    """Frames of the bodies that a fault concerns, in the order of arrival."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._before = self._ignored
        self.received: list[BodyPose] = []
        self._clock = SystemClock()
        self._last = self._clock.monotonic()

    def take(self, pose: BodyPose) -> None:
        """Record a frame."""
        self.received.append(pose)
        self._last = self._clock.monotonic()

    @property
    def _ignored(self) -> int:
        return self._bus.counters()["bus.ignored"]

    @property
    def not_finite(self) -> int:
        """Number of frames that the subscriber's bus rejected because a number is not finite."""
        return self._ignored - self._before

    @property
    def silence(self) -> float:
        """Time since the last frame, s of the machine."""
        return self._clock.monotonic() - self._last

    def count_showing(self, name: str, arguments: dict[str, Any]) -> int:
        """Return how many frames show a fault.

        Args:
            name: Name of the fault.
            arguments: Arguments of the fault.
        """
        sign = SIGNS[name]
        return sum(
            sign(last, pose, arguments)
            for body in {pose.body for pose in self.received}
            for last, pose in pairwise([each for each in self.received if each.body == body])
        )


@asynccontextmanager
async def poses(cell: RunningCell, body: str = "*") -> AsyncIterator[ReceivedPoses]:
    """Collect the frames of one body, or of all, that a subscriber receives during the context.

    The context begins when the first frame, still without the fault, has come.

    Args:
        cell: Cell with the tracker.
        body: Name of a body; ``*`` for all.
    """
    found = ReceivedPoses(cell.bus)
    end = cell.bus.subscribe(f"state/pose/{body}", BodyPose, lambda _, pose: found.take(pose))
    try:
        await until_true(lambda: bool(found.received), "No frame of the tracker is received without the fault")
        yield found
    finally:
        await end()


def shown(seen: ReceivedPoses, name: str, arguments: dict[str, Any]) -> dict[str, float]:
    """Return details of how a tracker's fault was observed by its subscriber.

    Args:
        seen: Frames that the subscriber has received.
        name: Name of the fault.
        arguments: Arguments of the fault.

    Raises:
        Unmet: It was not observed.
    """
    measured: dict[str, float]
    if name == "tracker_absent":
        measured = {"silent_s": seen.silence if seen.silence > SILENCE else 0.0}
    elif name == "pose_nan":
        measured = {"frames": seen.not_finite}
    else:
        measured = {"frames": seen.count_showing(name, arguments), "of": len(seen.received)}
    if not all(measured.values()):
        raise Unmet(f"No subscriber has seen '{name}': {measured}.")
    return measured
