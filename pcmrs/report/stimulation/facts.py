"""What a report says in numbers: errors against the truth of a simulation, means over placements, counts of pulses."""

from __future__ import annotations

import math

import msgspec

from pcmrs.analysis.placements import Summary, summarize
from pcmrs.analysis.session import PulseRecord, SessionRecord
from pcmrs.spatial import distance
from pcmrs.tms.scalp import as_transform, heading


class Facts(msgspec.Struct, frozen=True, kw_only=True):
    """Numbers of one session; what there is nothing for is None.

    Attributes:
        placement_mm: Over all placements.
        coil_mm: Of the coil right before the pulses.
        counted: Pulses that tell something about the muscle.
        responses: Of them, those with a response.
        repeated: Pulses that do not count, and were given again.
        refused: Commands that were not accepted.
        hotspot_error_mm: Of the place that was found, against the true one.
        hotspot_error_deg: The same for the handle.
        threshold_error: Against the true threshold where it was hunted, percent of it.
        inside: Whether the interval holds that; None where there is none.
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
    """All that a report works out of a record."""
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
