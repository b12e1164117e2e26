"""From what the tracker answered to poses of bodies, or why there are none."""

from __future__ import annotations

from collections import Counter

from pcmrs.devices.ndi.wire import Frame, ToolFrame
from pcmrs.messages import BodyPose

OUT_OF_VOLUME, PARTIALLY_OUT, PORT_INTERFERENCE = 0x040, 0x080, 0x200
"""Bits of a port's status."""
SYSTEM_INTERFERENCE, TEMPERATURE = 0x0002, 0x0100
"""Bits of the system's status."""

FROZEN_TIME = 0.5
"""A tracker that answers but has had no new frame for so long is frozen, s: longer than a frame at 5 Hz."""


RESTARTED = 5
"""So many frames in a row that advance from below the last one show that the tracker counts anew."""


class FrameReader:
    """Turns answers into poses; the same frame is answered to many questions and taken once.

    Args:
        latency: From the exposure until a frame can be had, s.
        max_error: Beyond this fit error there is no pose, m.

    Attributes:
        refused: Frames that were not new, counted by ``frozen`` and ``reversed``.
    """

    def __init__(self, latency: float, max_error: float) -> None:
        self.refused: Counter[str] = Counter()
        self._latency = latency
        self._max_error = max_error
        self._number = -1
        self._offset = 0
        self._anew = False
        self._behind: list[int] = []
        self._new_at: float | None = None

    def begin_anew(self) -> None:
        """The tracker was set up again: where it counts from the beginning, its numbers go on from the last one."""
        self._anew = True

    def poses(self, frame: Frame, now: float) -> list[BodyPose]:
        """The bodies of a new frame; of one that is not new, that it is not, once it should be.

        Args:
            frame: The answer.
            now: When it is passed on, s of the machine's monotonic clock.
        """
        if not frame.tools:
            return []
        number = self._offset + max(tool.frame_number for tool in frame.tools)
        if (self._anew and number <= self._number) or self._counts_anew(number):
            self._offset += self._number + 1 - number
            number = self._number + 1
        self._anew = False
        if number > self._number:
            self._number, self._new_at = number, frame.arrived
            return [self._pose(tool, frame, now) for tool in frame.tools]
        if number < self._number:
            return self._refuse("reversed", frame, now)
        if self._new_at is not None and frame.arrived - self._new_at > FROZEN_TIME:
            self._new_at = frame.arrived
            return self._refuse("frozen", frame, now)
        return []

    def _counts_anew(self, number: int) -> bool:
        """Whether the tracker counts from the beginning though nobody has set it up again."""
        if number >= self._number or (self._behind and number < self._behind[-1]):
            self._behind.clear()
        if number < self._number and (not self._behind or number > self._behind[-1]):
            self._behind.append(number)
        if len(self._behind) < RESTARTED:
            return False
        self._behind.clear()
        return True

    def _refuse(self, reason: str, frame: Frame, now: float) -> list[BodyPose]:
        self.refused[reason] += 1
        return [self._unseen(tool, frame, now, reason) for tool in frame.tools]

    def _pose(self, tool: ToolFrame, frame: Frame, now: float) -> BodyPose:
        reason = reason_of(tool, frame.system_status, self._max_error)
        if reason is not None or tool.numbers is None:
            return self._unseen(tool, frame, now, reason or "missing")
        w, i, j, k, x_mm, y_mm, z_mm, error_mm = tool.numbers
        return BodyPose(
            body=tool.body,
            frame_number=self._offset + tool.frame_number,
            captured=frame.arrived - self._latency,
            sent=now,
            valid=True,
            position=(x_mm / 1000.0, y_mm / 1000.0, z_mm / 1000.0),
            quat_wxyz=(w, i, j, k),
            error=error_mm / 1000.0,
        )

    def _unseen(self, tool: ToolFrame, frame: Frame, now: float, reason: str) -> BodyPose:
        return BodyPose(
            body=tool.body,
            frame_number=self._offset + tool.frame_number,
            captured=frame.arrived - self._latency,
            sent=now,
            valid=False,
            reason=reason,
        )


def reason_of(tool: ToolFrame, system_status: int, max_error: float) -> str | None:
    """Why the pose of a tool may not be used; None when it may.

    Args:
        tool: As the tracker answered.
        system_status: What concerns all tools.
        max_error: Largest fit error, m.
    """
    found = (
        ("temperature", system_status & TEMPERATURE),
        ("interference", system_status & SYSTEM_INTERFERENCE or tool.status & PORT_INTERFERENCE),
        ("out_of_volume", tool.status & OUT_OF_VOLUME),
        ("partially_out", tool.status & PARTIALLY_OUT),
        ("missing", tool.numbers is None),
        ("fit_error", tool.numbers is not None and not tool.numbers[7] / 1000.0 <= max_error),
    )
    return next((reason for reason, is_so in found if is_so), None)
