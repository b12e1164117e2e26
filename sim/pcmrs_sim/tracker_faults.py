"""Faults of the optical tracker: rows S of the fault catalogue."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from pcmrs.messages import BodyPose
from pcmrs_sim.fault import Fault
from pcmrs_sim.fault_arguments import choice, number, switch

if TYPE_CHECKING:
    from pcmrs_sim.cell import Cell
    from pcmrs_sim.tracker import SimTracker

BODIES = ("coil", "body_ref", "pointer", "witness")
"""What the tracker knows."""

NOT_UNIT = 1.2
"""Length of a quaternion that is none."""
BAD_FIT = 3e-3
"""Fit error of a tool that is bent, or of which markers are hidden in part, m."""
PHANTOM_OFFSET = (0.0, 0.06, 0.0)
"""How far a reflection beside a marker body moves its pose, m."""
STAMP_OFFSET = 10.0
"""By how much a wrong stamp is wrong, s."""

MOST_JUMP_MM = 1000.0
MOST_RATE_HZ = 400.0

REASONS = ("out_of_volume", "partially_out", "temperature", "interference")
"""What a tracker says of a body that it does not measure well."""


@dataclass
class TrackerFaults:
    """What is wrong with the tracker now.

    Attributes:
        silent: It sends and answers nothing, as if it were not there.
        plugged: The position sensor is connected to the unit that answers.
        frozen: Frames repeat the last number.
        reversed: Frame numbers and stamps run backwards.
        future: Stamps lie in the future.
        rate_hz: In place of its own rate.
        reasons: Bodies that are not measured, and why.
        not_finite: Bodies whose position is not a number.
        not_unit: Bodies whose quaternion is none.
        bad_fit: Bodies that fit badly.
        wrong_tools: Bodies that carry another tool than the one that is defined.
        phantoms: Bodies that stand in every other frame where a reflection has them.
        jumps: Bodies that are seen elsewhere, m.
        swapped: Two bodies taken for each other.
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
        """Whether frames go out at all."""
        return self.plugged and not self.silent

    def distort(self, frame: Sequence[BodyPose], last: Sequence[BodyPose]) -> list[BodyPose]:
        """The frame as the faulty tracker publishes it after `last`."""
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
        return msgspec.structs.replace(pose, **changes)

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


def _tracker(cell: Cell) -> SimTracker:
    tracker: SimTracker = cell.devices["tracker"]  # type: ignore[assignment]
    return tracker


def _flag(attribute: str, value: bool = True) -> Callable[[Cell, Mapping[str, Any]], None]:
    def apply(cell: Cell, arguments: Mapping[str, Any]) -> None:
        setattr(_tracker(cell).faults, attribute, value if switch(arguments, "on") else not value)

    return apply


def _of_body(attribute: str) -> Callable[[Cell, Mapping[str, Any]], None]:
    def apply(cell: Cell, arguments: Mapping[str, Any]) -> None:
        _switch_body(getattr(_tracker(cell).faults, attribute), arguments)

    return apply


def _occlude(cell: Cell, arguments: Mapping[str, Any]) -> None:
    _switch_body(_tracker(cell).hidden, arguments)


def _switch_body(bodies: set[str], arguments: Mapping[str, Any]) -> None:
    body = choice(arguments, "body", BODIES)
    if switch(arguments, "on"):
        bodies.add(body)
    else:
        bodies.discard(body)


def _reason(cell: Cell, arguments: Mapping[str, Any]) -> None:
    body, reason = choice(arguments, "body", BODIES), choice(arguments, "reason", REASONS)
    if switch(arguments, "on"):
        _tracker(cell).faults.reasons[body] = reason
    else:
        _tracker(cell).faults.reasons.pop(body, None)


def _jump(cell: Cell, arguments: Mapping[str, Any]) -> None:
    body = choice(arguments, "body", BODIES)
    by_mm = number(arguments, "millimetres", -MOST_JUMP_MM, MOST_JUMP_MM)
    _tracker(cell).faults.jumps[body] = (by_mm * 1e-3, 0.0, 0.0)


def _swap(cell: Cell, arguments: Mapping[str, Any]) -> None:
    pair = choice(arguments, "first", BODIES), choice(arguments, "second", BODIES)
    _tracker(cell).faults.swapped = pair if switch(arguments, "on") else None


def _rate(cell: Cell, arguments: Mapping[str, Any]) -> None:
    _tracker(cell).faults.rate_hz = number(arguments, "hertz", 0.0, MOST_RATE_HZ) or None


FAULTS: tuple[Fault, ...] = (
    Fault("occlude", "S1", "Something hides a body from the tracker.", ("body", "on"), _occlude),
    Fault("frame_frozen", "S2", "Frames repeat one number.", ("on",), _flag("frozen")),
    Fault("pose_nan", "S3", "A body's position is not a number.", ("body", "on"), _of_body("not_finite")),
    Fault("pose_not_unit", "S4", "A body's quaternion is not of length 1.", ("body", "on"), _of_body("not_unit")),
    Fault("pose_jump", "S5", "A body is seen so much aside; 0 puts it back.", ("body", "millimetres"), _jump),
    Fault("not_measured", "S7", f"For one of {', '.join(REASONS)}.", ("body", "reason", "on"), _reason),
    Fault("bad_fit", "S7", "A body fits its markers badly.", ("body", "on"), _of_body("bad_fit")),
    Fault("phantom_marker", "S8", "A reflection moves every other pose.", ("body", "on"), _of_body("phantoms")),
    Fault("tool_swap", "S8", "Two bodies are taken for each other.", ("first", "second", "on"), _swap),
    Fault("wrong_tool", "S9", "Another tool than the defined one is mounted.", ("body", "on"), _of_body("wrong_tools")),
    Fault("tracker_rate", "S10", "The rate falls; 0 is the tracker's own.", ("hertz",), _rate),
    Fault("stamp_reversed", "S11", "Numbers and stamps run backwards.", ("on",), _flag("reversed")),
    Fault("stamp_future", "S11", "Stamps lie in the future.", ("on",), _flag("future")),
    Fault("tracker_unplugged", "S2", "The position sensor is unplugged.", ("on",), _flag("plugged", False)),
    Fault("tracker_absent", "S2", "The tracker answers nothing.", ("on",), _flag("silent")),
)
