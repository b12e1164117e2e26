"""When a pulse may be given, and what is made of the response."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.tms.intervals import IntervalSettings
from pcmrs.tms.settings import HotspotSettings, MepSettings, ThresholdSettings
from pcmrs.workflows.settings.values import Positive


class StimulationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a pulse may be given, and how its response is measured and used.

    Attributes:
        tolerance_mm: The coil may be so far from its planned pose in the newest frame.
        tolerance_deg: The same for its rotation.
        pose_age: That frame is so old at most, s.
        body_speed: The planned pose on the body moves so fast at most, m/s: at 0.010 the head goes 0.6 mm in 60 ms, of
            which the tracker cannot know yet.
        speed_time: By the frames of so long, s.
        ready_time: Longest wait for a stimulator that charges, s.
        dialled: An operator turns the stimulator's dial: the intensity that a hunt needs next is then to be set by
            `stimulation.set_intensity`, and no pulse of another one is given.
        epoch_before: Of the signal before a pulse, s.
        epoch_after: The same after it.
        intervals: How soon after another, and how many.
        mep: What counts as a response.
        threshold: How a threshold is hunted.
        hotspot: How a hot-spot is searched for.

    Raises:
        ValueError: An epoch would not hold what is looked at in it.
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
