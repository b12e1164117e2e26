"""Faults of the optical tracker: rows S of the fault catalogue."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pcmrs_sim.faults.fault import Fault, FaultTarget, choice, number, switch
from pcmrs_sim.tracker_faults import BODIES

LARGEST_JUMP_MM = 1000.0
"""Largest offset of a measured body, mm."""
LARGEST_RATE_HZ = 400.0
"""Highest frame rate, Hz."""
REASONS = ("out_of_volume", "partially_out", "temperature", "interference")
"""Reasons that a tracker gives for a body that it does not measure well."""


def _flag(attribute: str, value: bool = True) -> Callable[[FaultTarget, Mapping[str, Any]], None]:
    def apply(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
        setattr(cell.tracker.faults, attribute, value if switch(arguments, "on") else not value)

    return apply


def _of_body(attribute: str) -> Callable[[FaultTarget, Mapping[str, Any]], None]:
    def apply(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
        _switch_body(getattr(cell.tracker.faults, attribute), arguments)

    return apply


def _occlude(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    _switch_body(cell.tracker.hidden, arguments)


def _switch_body(bodies: set[str], arguments: Mapping[str, Any]) -> None:
    body = choice(arguments, "body", BODIES)
    if switch(arguments, "on"):
        bodies.add(body)
    else:
        bodies.discard(body)


def _reason(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    body, reason = choice(arguments, "body", BODIES), choice(arguments, "reason", REASONS)
    if switch(arguments, "on"):
        cell.tracker.faults.reasons[body] = reason
    else:
        cell.tracker.faults.reasons.pop(body, None)


def _jump(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    body = choice(arguments, "body", BODIES)
    by_mm = number(arguments, "millimetres", -LARGEST_JUMP_MM, LARGEST_JUMP_MM)
    cell.tracker.faults.jumps[body] = (by_mm * 1e-3, 0.0, 0.0)


def _swap(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    pair = choice(arguments, "first", BODIES), choice(arguments, "second", BODIES)
    cell.tracker.faults.swapped = pair if switch(arguments, "on") else None


def _rate(cell: FaultTarget, arguments: Mapping[str, Any]) -> None:
    cell.tracker.faults.rate_hz = number(arguments, "hertz", 0.0, LARGEST_RATE_HZ) or None


FAULTS: tuple[Fault, ...] = (
    Fault("occlude", "S1", "Something hides a body from the tracker.", ("body", "on"), _occlude),
    Fault("frame_frozen", "S2", "Frames repeat one number and stamp.", ("on",), _flag("frozen")),
    Fault("pose_nan", "S3", "A body's position is not finite.", ("body", "on"), _of_body("not_finite")),
    Fault("pose_not_unit", "S4", "A body's quaternion is not of length 1.", ("body", "on"), _of_body("not_unit")),
    Fault("pose_jump", "S5", "A body is measured with this offset; 0 ends it.", ("body", "millimetres"), _jump),
    Fault("not_measured", "S7", f"Reasons: {', '.join(REASONS)}.", ("body", "reason", "on"), _reason),
    Fault("bad_fit", "S7", "A body fits its markers badly.", ("body", "on"), _of_body("bad_fit")),
    Fault("phantom_marker", "S8", "A reflection displaces every other pose.", ("body", "on"), _of_body("phantoms")),
    Fault("tool_swap", "S8", "The tracker confuses two bodies.", ("first", "second", "on"), _swap),
    Fault("wrong_tool", "S9", "Another tool than the defined one is mounted.", ("body", "on"), _of_body("wrong_tools")),
    Fault("tracker_rate", "S10", "The frame rate, Hz; 0 restores the configured one.", ("hertz",), _rate),
    Fault("stamp_reversed", "S11", "Numbers and stamps run backwards.", ("on",), _flag("reversed")),
    Fault("stamp_future", "S11", "Stamps lie in the future.", ("on",), _flag("future")),
    Fault("tracker_unplugged", "S2", "The position sensor is unplugged.", ("on",), _flag("plugged", False)),
    Fault("tracker_absent", "S2", "The tracker answers nothing.", ("on",), _flag("silent")),
)
