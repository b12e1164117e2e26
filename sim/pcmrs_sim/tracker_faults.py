"""Present faults of the optical tracker, and the frames that it then sends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from pcmrs.messages import BodyPose

BODIES = ("coil", "body_ref", "pointer", "witness")
"""Tracked marker bodies."""

NOT_UNIT = 1.2
"""Length of a quaternion that is not a unit quaternion."""
BAD_FIT = 3e-3
"""Fit error of a tool that is bent, or whose markers are partly hidden, m."""
PHANTOM_OFFSET = (0.0, 0.06, 0.0)
"""Displacement of a pose by a reflection beside the marker body, in the tracker frame, m."""
STAMP_OFFSET = 10.0
"""Error of a wrong time stamp, s."""


@dataclass
class TrackerFaults:
    """Present faults.

    Attributes:
        silent: The tracker sends and answers nothing, as if it were absent.
        plugged: The position sensor is connected to the unit that answers.
        frozen: Frames repeat the last number and stamp.
        reversed: Frame numbers and stamps run backwards.
        future: Stamps lie in the future.
        rate_hz: Frame rate that replaces the configured one; None for the configured one.
        reasons: Bodies that are not measured, with the reason.
        not_finite: Bodies whose position is not finite.
        not_unit: Bodies whose quaternion has not length 1.
        bad_fit: Bodies with a large fit error.
        wrong_tools: Bodies that carry another tool than the defined one.
        phantoms: Bodies that a reflection displaces in every other frame.
        jumps: Bodies that are measured with an offset in the tracker frame, m.
        swapped: Two bodies whose names are exchanged; None if none are.
    """

    silent: bool = False
    plugged: bool = True
    frozen: bool = False
    reversed: bool = False
    future: bool = False
    rate_hz: float | None = None
    reasons: dict[str, str] = field(default_factory=dict)
    not_finite: set[str] = field(default_factory=set)
    not_unit: set[str] = field(default_factory=set)
    bad_fit: set[str] = field(default_factory=set)
    wrong_tools: set[str] = field(default_factory=set)
    phantoms: set[str] = field(default_factory=set)
    jumps: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    swapped: tuple[str, str] | None = None

    @property
    def sending(self) -> bool:
        """True if frames are sent."""
        return self.plugged and not self.silent

    def distort(self, frame: Sequence[BodyPose], last: Sequence[BodyPose]) -> list[BodyPose]:
        """Return a frame as the faulty tracker publishes it.

        Args:
            frame: Poses of all bodies without faults.
            last: Frame that was published before; empty before the first.
        """
        poses = [self._numbered(self._distorted(pose), last) for pose in frame]
        if self.swapped is None:
            return poses
        first, second = self.swapped
        other = {first: second, second: first}
        return [msgspec.structs.replace(pose, body=other.get(pose.body, pose.body)) for pose in poses]

    def _distorted(self, pose: BodyPose) -> BodyPose:
        body, changes = pose.body, dict[str, Any]()
        if body in self.reasons:
            changes = {"valid": False, "reason": self.reasons[body]}
        elif body in self.wrong_tools:
            changes = {"valid": False, "reason": "wrong_tool"}
        elif pose.valid:
            if body in self.not_finite:
                changes["position"] = (math.nan, math.inf, 0.0)
            if body in self.not_unit:
                changes["quat_wxyz"] = tuple(NOT_UNIT * value for value in pose.quat_wxyz)
            if body in self.bad_fit:
                changes["error"] = BAD_FIT
            if body in self.phantoms and pose.frame_number % 2:
                changes["position"] = _moved(pose, PHANTOM_OFFSET)
            if body in self.jumps:
                changes["position"] = _moved(pose, self.jumps[body])
        return msgspec.structs.replace(pose, **changes) if changes else pose

    def _numbered(self, pose: BodyPose, last: Sequence[BodyPose]) -> BodyPose:
        if self.frozen and last:
            return msgspec.structs.replace(pose, frame_number=last[0].frame_number, captured=last[0].captured)
        if self.reversed and last:
            captured = last[0].captured - STAMP_OFFSET
            return msgspec.structs.replace(pose, frame_number=max(0, last[0].frame_number - 1), captured=captured)
        if self.future:
            return msgspec.structs.replace(pose, captured=pose.sent + STAMP_OFFSET)
        return pose


def _moved(pose: BodyPose, offset: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (np.array(pose.position) + offset).tolist()
    return x, y, z
