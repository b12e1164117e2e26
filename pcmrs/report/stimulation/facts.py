"""Numbers of the report: errors against the truth of a simulation, means over placements, counts of pulses."""

from __future__ import annotations

import math

import msgspec

from pcmrs.analysis.placements import Summary, summarize
from pcmrs.analysis.session import PulseRecord, SessionRecord
from pcmrs.spatial import distance
from pcmrs.tms.scalp import as_transform, heading


class Facts(msgspec.Struct, frozen=True, kw_only=True):
    """Numbers of one session; missing ones are None.

    Attributes:
        placement_mm: Errors of all placements.
        coil_mm: Errors of the coil right before the pulses.
        counted: Number of pulses with a valid measurement.
        responses: Number of counted pulses with a response.
        repeated: Number of pulses that do not count, and were given again.
        refused: Number of commands that were not accepted.
        hotspot_error_mm: Distance of the found hot-spot from the true one.
        hotspot_error_deg: Angle of the found handle direction from the true one.
        threshold_error: Error of the threshold, percent of the true one at the same pose.
        inside: True if the interval contains the true threshold; None if there is no interval.
    """

    pulses: int
    counted: int
    responses: int
    repeated: int
    refused: int
    placement_mm: Summary | None = None
    placement_deg: Summary | None = None
    coil_mm: Summary | None = None
    hotspot_error_mm: float | None = None
    hotspot_error_deg: float | None = None
    threshold_error: float | None = None
    inside: bool | None = None


def facts_of(record: SessionRecord) -> Facts:
    """Return the numbers of a session."""
    counted = [pulse for pulse in record.pulses if not pulse.problem]
    hotspot_mm, hotspot_deg = _hotspot_errors(record)
    error, inside = _threshold_error(record)
    return Facts(
        pulses=len(record.pulses),
        counted=len(counted),
        responses=sum(_responded(pulse) for pulse in counted),
        repeated=len(record.pulses) - len(counted),
        refused=sum(refusal.times for refusal in record.refusals),
        placement_mm=_summary([placement.error_mm for placement in record.placements]),
        placement_deg=_summary([placement.error_deg for placement in record.placements]),
        coil_mm=_summary([pulse.error_mm for pulse in record.pulses]),
        hotspot_error_mm=hotspot_mm,
        hotspot_error_deg=hotspot_deg,
        threshold_error=error,
        inside=inside,
    )


def _responded(pulse: PulseRecord) -> bool:
    return pulse.mep is not None and pulse.mep.present


def _summary(values: list[float]) -> Summary | None:
    return summarize(values) if values else None


def _hotspot_errors(record: SessionRecord) -> tuple[float | None, float | None]:
    if record.truth is None or record.hotspot is None:
        return None, None
    true, found = as_transform(record.truth.hotspot), as_transform(record.hotspot.image_from_coil)
    return 1e3 * distance(true, found), math.degrees(abs(heading(true, found)))


def _threshold_error(record: SessionRecord) -> tuple[float | None, bool | None]:
    truth, found = record.truth, record.threshold
    if truth is None or truth.threshold_here is None or found is None:
        return None, None
    within = None if found.low is None or found.high is None else found.low <= truth.threshold_here <= found.high
    return 100.0 * (found.threshold / truth.threshold_here - 1.0), within
