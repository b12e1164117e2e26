"""Conversion of the tracker's answers into poses of bodies, or into the reasons why there are none."""

from __future__ import annotations

from collections import Counter

from pcmrs.devices.ndi.wire import NdiFrame, ToolFrame
from pcmrs.messages import BodyPose

OUT_OF_VOLUME, PARTIALLY_OUT, PORT_INTERFERENCE = 0x040, 0x080, 0x200
"""Bits of a port's status."""
SYSTEM_INTERFERENCE, TEMPERATURE = 0x0002, 0x0100
"""Bits of the system's status."""

FROZEN_TIME = 0.5
"""Time without a new frame after which a tracker that answers is frozen, s: longer than a frame at 5 Hz."""

FRAMES_TO_RESTART = 5
"""Number of successive frames that advance from below the last one after which the tracker has restarted its count."""


class FrameReader:
    """Converter of answers to poses. Many polls return the same frame, which is converted once.

    Args:
        latency: Time from the exposure until a frame is available, s.
        max_error: Largest fit error of a valid pose, m.

    Attributes:
        refused: Number of frames that were not new, by ``frozen`` and ``reversed``.
    """

    def __init__(self, latency: float, max_error: float) -> None:
        self.refused: Counter[str] = Counter()
        self._latency = latency
        self._max_error = max_error
        self._number = -1
        self._offset = 0
        self._restarted = False
        self._behind: list[int] = []
        self._new_at: float | None = None

    def restart(self) -> None:
        """Continue the frame numbers after the tracker was set up again, if it restarts its count."""
        self._restarted = True

    def poses(self, frame: NdiFrame, now: float) -> list[BodyPose]:
        """Return the bodies of a new frame; empty for a repeated one.

        A frame that should be new but is not gives bodies without a pose, with the reason ``frozen`` or ``reversed``.

        Args:
            frame: Answer of the tracker.
            now: Time at which it is passed on, s of the machine's monotonic clock.
        """
        if not frame.tools:
            return []
        number = self._offset + max(tool.frame_number for tool in frame.tools)
        if (self._restarted and number <= self._number) or self._count_restarted(number):
            self._offset += self._number + 1 - number
            number = self._number + 1
        self._restarted = False
        if number > self._number:
            self._number, self._new_at = number, frame.arrived
            return [self._pose(tool, frame, now) for tool in frame.tools]
        if number < self._number:
            return self._refuse("reversed", frame, now)
        if self._new_at is not None and frame.arrived - self._new_at > FROZEN_TIME:
            self._new_at = frame.arrived
            return self._refuse("frozen", frame, now)
        return []

    def _count_restarted(self, number: int) -> bool:
        """Return True if the tracker has restarted its count although it was not set up again."""
        if number >= self._number or (self._behind and number < self._behind[-1]):
            self._behind.clear()
        if number < self._number and (not self._behind or number > self._behind[-1]):
            self._behind.append(number)
        if len(self._behind) < FRAMES_TO_RESTART:
            return False
        self._behind.clear()
        return True

    def _refuse(self, reason: str, frame: NdiFrame, now: float) -> list[BodyPose]:
        self.refused[reason] += 1
        return [self._unseen(tool, frame, now, reason) for tool in frame.tools]

    def _pose(self, tool: ToolFrame, frame: NdiFrame, now: float) -> BodyPose:
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

    def _unseen(self, tool: ToolFrame, frame: NdiFrame, now: float, reason: str) -> BodyPose:
        return BodyPose(
            body=tool.body,
            frame_number=self._offset + tool.frame_number,
            captured=frame.arrived - self._latency,
            sent=now,
            valid=False,
            reason=reason,
        )


def reason_of(tool: ToolFrame, system_status: int, max_error: float) -> str | None:
    """Return why the pose of a tool may not be used; None if it may.

    Args:
        tool: Tool in the answer of the tracker.
        system_status: Status bits that concern all tools.
        max_error: Largest fit error of a valid pose, m.
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
