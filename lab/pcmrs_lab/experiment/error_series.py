"""Observation of a tool that follows: its true error, the error that the tracker measures, and its alignment."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.messages import BodyPose, SceneTruth, Snapshot
from pcmrs.spatial import Floats, Transform, distance
from pcmrs.workflows.data import as_transform

PERIOD = 0.02
"""Time between two samples of the ground truth, s of the machine."""
HISTORY = 64
"""Number of tracker frames that are stored, since frames may come late."""


@dataclass
class ErrorSeries:
    """Errors of one run, mm, and their times since its beginning, s of the cell.

    Attributes:
        allowed: True where the tool counted as aligned.
        measured_mm: Errors of the tracker's frames, mm.
        lag: Delay of the simulation behind its clock, s.
    """

    times: list[float] = field(default_factory=list)
    true_mm: list[float] = field(default_factory=list)
    allowed: list[bool] = field(default_factory=list)
    measured_mm: list[float] = field(default_factory=list)
    lag: float = 0.0

    def true_allowed_mm(self) -> Floats:
        """Return the true errors while the tool counted as aligned, mm, (N,)."""
        errors: Floats = np.array(self.true_mm)[np.array(self.allowed, dtype=bool)]
        return errors


class PlacementErrorMonitor:
    """Observer of a running cell from outside.

    Args:
        client: Client of the daemon.
        scene: Ground truth of the simulation.
        body_ref_from_tool_tip: Pose of the tool in the body frame as registered and planned.
        tool_marker_from_tool_tip: Contact point of the tool in its marker body.
        rate: Seconds of the cell per second of the machine.
    """

    def __init__(
        self,
        client: Client,
        scene: RemoteScene,
        body_ref_from_tool_tip: Transform,
        tool_marker_from_tool_tip: Transform,
        rate: float,
    ) -> None:
        self.snapshot: Snapshot | None = None
        self._changed = asyncio.Event()
        self._scene = scene
        self._desired, self._tool_marker_from_tool_tip = body_ref_from_tool_tip, tool_marker_from_tool_tip
        self._clock, self._rate = SystemClock(), rate
        self._frames: deque[BodyPose] = deque(maxlen=HISTORY)
        self._series: ErrorSeries | None = None
        client.listen("state/fsm", Snapshot, self._take_snapshot)
        client.listen("state/pose/*", BodyPose, self._take_pose)

    async def watch(self, duration: float, *, even_if_lost: bool = False) -> ErrorSeries:
        """Record the errors for some time, or until the tool does not follow any more.

        Args:
            duration: Duration, s of the cell.
            even_if_lost: True to continue although the tool does not follow.

        Returns:
            Errors of the run.
        """
        series = self._series = ErrorSeries()
        started, machine = (await self._scene.truth()).time, self._clock.monotonic()
        while True:
            truth = await self._scene.truth()
            series.times.append(truth.time - started)
            series.true_mm.append(self._error(truth) * 1000.0)
            series.allowed.append(self.state("alignment") == "1")
            series.lag = (self._clock.monotonic() - machine) * self._rate - series.times[-1]
            if series.times[-1] >= duration or not (even_if_lost or self.state("placement") == "following"):
                self._series = None
                return series
            await asyncio.sleep(PERIOD)

    async def aligned(self, timeout: float) -> bool:
        """Wait until the tool counts as aligned, and return whether it does.

        Args:
            timeout: Time limit, s of the machine.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while self.state("alignment") != "1":
                    self._changed.clear()
                    await self._changed.wait()
        return self.state("alignment") == "1"

    def state(self, branch: str) -> str:
        """Return the last published state of a branch; empty before the first snapshot."""
        return self.snapshot.branches[branch] if self.snapshot is not None else ""

    def _error(self, truth: SceneTruth) -> float:
        return distance(
            as_transform(truth.tracker_from_body_ref) @ self._desired, as_transform(truth.tracker_from_coil)
        )

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        self._changed.set()

    def _take_pose(self, pose: BodyPose) -> None:
        """Compare tool and body of one frame, whichever comes last."""
        if self._series is None or not pose.valid or pose.body not in ("coil", "body_ref"):
            return
        other = next((seen for seen in self._frames if seen.frame_number == pose.frame_number), None)
        if other is None or other.body == pose.body:
            self._frames.append(pose)
            return
        coil, body_ref = (pose, other) if pose.body == "coil" else (other, pose)
        tracker_from_tool_tip = _transform(coil) @ self._tool_marker_from_tool_tip
        error = distance(_transform(body_ref) @ self._desired, tracker_from_tool_tip)
        self._series.measured_mm.append(error * 1000.0)


def _transform(pose: BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
