"""What is seen of a tool that follows: its true error, the one that the tracker measures, and whether it is aligned."""

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
"""Between two looks at the truth, s of the machine."""
HISTORY = 64
"""Frames of the tracker that may come late."""


@dataclass
class ErrorSeries:
    """Errors of one run, in mm, and the times since its beginning at which they were, s of the cell.

    Attributes:
        allowed: Whether the tool counted as aligned then.
        measured_mm: Of the tracker's frames.
        lag: By how much the simulation fell behind its clock, s.
    """

    times: list[float] = field(default_factory=list)
    true_mm: list[float] = field(default_factory=list)
    allowed: list[bool] = field(default_factory=list)
    measured_mm: list[float] = field(default_factory=list)
    lag: float = 0.0

    def true_allowed_mm(self) -> Floats:
        """True errors while the tool counted as aligned, (N,)."""
        errors: Floats = np.array(self.true_mm)[np.array(self.allowed, dtype=bool)]
        return errors


class PlacementErrorMonitor:
    """Looks at a running cell from outside.

    Args:
        client: Of its daemon.
        scene: Its truth.
        body_ref_from_coil: Where the tool should be on the body, as registered and planned.
        rate: Of the cell.
    """

    def __init__(self, client: Client, scene: RemoteScene, body_ref_from_coil: Transform, rate: float) -> None:
        self.snapshot: Snapshot | None = None
        self._told = asyncio.Event()
        self._scene = scene
        self._desired = body_ref_from_coil
        self._clock, self._rate = SystemClock(), rate
        self._frames: deque[BodyPose] = deque(maxlen=HISTORY)
        self._series: ErrorSeries | None = None
        client.listen("state/fsm", Snapshot, self._take_snapshot)
        client.listen("state/pose/*", BodyPose, self._take_pose)

    async def watch(self, duration: float, *, whatever: bool = False) -> ErrorSeries:
        """Looks on for `duration`, s of the cell, or until the tool does not follow any more; or `whatever` it does."""
        series = self._series = ErrorSeries()
        begun, machine = (await self._scene.truth()).time, self._clock.monotonic()
        while True:
            truth = await self._scene.truth()
            series.times.append(truth.time - begun)
            series.true_mm.append(self._error(truth) * 1000.0)
            series.allowed.append(self.state("alignment") == "1")
            series.lag = (self._clock.monotonic() - machine) * self._rate - series.times[-1]
            if series.times[-1] >= duration or not (whatever or self.state("placement") == "following"):
                self._series = None
                return series
            await asyncio.sleep(PERIOD)

    async def aligned(self, timeout: float) -> bool:
        """Waits until the tool counts as aligned: whether it does within `timeout`, s of the machine."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while self.state("alignment") != "1":
                    self._told.clear()
                    await self._told.wait()
        return self.state("alignment") == "1"

    def state(self, branch: str) -> str:
        """Of a branch, as told last."""
        return self.snapshot.branches[branch] if self.snapshot is not None else ""

    def _error(self, truth: SceneTruth) -> float:
        return distance(
            as_transform(truth.tracker_from_body_ref) @ self._desired, as_transform(truth.tracker_from_coil)
        )

    def _take_snapshot(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        self._told.set()

    def _take_pose(self, pose: BodyPose) -> None:
        """Compares tool and body of one frame, whichever comes first."""
        if self._series is None or not pose.valid or pose.body not in ("coil", "body_ref"):
            return
        other = next((seen for seen in self._frames if seen.frame_number == pose.frame_number), None)
        if other is None or other.body == pose.body:
            self._frames.append(pose)
            return
        coil, body_ref = (pose, other) if pose.body == "coil" else (other, pose)
        error = distance(_transform(body_ref) @ self._desired, _transform(coil))
        self._series.measured_mm.append(error * 1000.0)


def _transform(pose: BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
