"""Settings of stimulation: conditions of a pulse, and use of its response."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.tms.intervals import IntervalSettings
from pcmrs.tms.settings import HotspotSettings, MepSettings, ThresholdSettings
from pcmrs.workflows.settings._values import Positive


class StimulationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Conditions of a pulse, and measurement and use of its response.

    Attributes:
        tolerance_mm: Largest distance of the coil from its planned pose in the newest frame, mm.
        tolerance_deg: Largest angle of the coil to its planned pose in the newest frame, deg.
        pose_age: Greatest age of that frame, s.
        body_speed: Greatest speed of the planned pose on the body, m/s. At 0.010 the head moves by 0.6 mm in the 60 ms
            of the tracker's latency.
        speed_time: Duration of the frames by which this speed is measured, s.
        ready_time: Longest wait for a stimulator that charges, s.
        dialled: True if an operator turns the stimulator's dial. The operator then reports the intensity that a hunt
            needs next by `stimulation.set_intensity`, and no pulse of another intensity is given.
        epoch_before: Duration of the recorded signal before a pulse, s.
        epoch_after: Duration of the recorded signal after a pulse, s.
        intervals: Limits of the interval and number of pulses.
        mep: Detection of a response.
        threshold: Hunt for a motor threshold.
        hotspot: Search for a hot-spot.

    Raises:
        ValueError: An epoch would not cover the baseline and the window of a response.
    """

    tolerance_mm: Positive = 1.5
    tolerance_deg: Positive = 3.0
    pose_age: Annotated[float, msgspec.Meta(gt=0.0, le=0.2)] = 0.15
    body_speed: Positive = 0.010
    speed_time: Annotated[float, msgspec.Meta(ge=0.1, le=0.5)] = 0.25
    ready_time: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 3.0
    dialled: bool = False
    epoch_before: Positive = 0.120
    epoch_after: Positive = 0.100
    intervals: IntervalSettings = IntervalSettings()
    mep: MepSettings = MepSettings()
    threshold: ThresholdSettings = ThresholdSettings()
    hotspot: HotspotSettings = HotspotSettings()

    def __post_init__(self) -> None:
        if -self.epoch_before > self.mep.baseline_start or self.epoch_after < self.mep.window_end:
            raise ValueError("epoch_before and epoch_after must cover mep.baseline_start and mep.window_end")
