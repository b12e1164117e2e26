"""Limits, distances and calibrations of a placement procedure."""

from __future__ import annotations

import msgspec

from pcmrs.calibration import ToolType
from pcmrs.workflows.settings.measuring import (
    LONGEST_UNSEEN,
    CalibrationSettings,
    RegistrationSettings,
    TrackingSettings,
)
from pcmrs.workflows.settings.moving import (
    AlignmentSettings,
    ContactSettings,
    FollowingSettings,
    MotionSettings,
    PlacementSettings,
    PressForce,
)
from pcmrs.workflows.settings.stimulation import StimulationSettings
from pcmrs.workflows.settings.teleoperation import TeleoperationSettings
from pcmrs.workflows.settings.values import PoseSetting, Positive
from pcmrs.workflows.settings.zones import TABLE, BodySettings, BoxSettings, ToolSettings, ZoneSettings

__all__ = [
    "TABLE",
    "AlignmentSettings",
    "BodySettings",
    "BoxSettings",
    "CalibrationSettings",
    "ContactSettings",
    "FollowingSettings",
    "MotionSettings",
    "PlacementSettings",
    "PoseSetting",
    "PressForce",
    "ProcedureSettings",
    "RegistrationSettings",
    "StimulationSettings",
    "TeleoperationSettings",
    "ToolSettings",
    "TrackingSettings",
    "ZoneSettings",
]


class ProcedureSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``procedure`` of the configuration.

    Attributes:
        max_pose_age: A tracked pose older than this is stale, s of the machine.
        home: Posture for `placement.home`, rad, base to flange; empty for the arm's own.
        patient: Whose registration it is; a previous registration or plan of another patient is refused.
        operator: Who is responsible, for the records; nothing is decided by it.
        abandoned_after: When nobody has asked for anything for so long while the tool is at the body or a stimulator is
            armed, the session is held, s of the machine.
        tool: What the workflow places; the calibration file of another type of tool is refused.
        limits: Further limits of the workflow's own checks, by name; its blueprint's defaults name them all.

    Raises:
        ValueError: `teleoperation.range` is not beyond `placement.standoff`, where guiding begins.
    """

    patient: str = "phantom"
    operator: str = ""
    max_pose_age: Positive = 0.25
    abandoned_after: Positive = 1800.0
    home: tuple[float, ...] = ()
    calibration: CalibrationSettings = CalibrationSettings()
    tool: ToolType = "coil"
    tracking: TrackingSettings = TrackingSettings()
    registration: RegistrationSettings = RegistrationSettings()
    motion: MotionSettings = MotionSettings()
    placement: PlacementSettings = PlacementSettings()
    alignment: AlignmentSettings = AlignmentSettings()
    following: FollowingSettings = FollowingSettings()
    contact: ContactSettings = ContactSettings()
    stimulation: StimulationSettings = StimulationSettings()
    teleoperation: TeleoperationSettings = TeleoperationSettings()
    zones: ZoneSettings = ZoneSettings()
    body: BodySettings = BodySettings()
    limits: dict[str, float] = {}

    def __post_init__(self) -> None:
        reach, standoff = self.teleoperation.range, self.placement.standoff
        if not reach > standoff:
            raise ValueError(
                f"teleoperation.range is {reach:g} m, but an approach ends at {standoff:g} m from the plan"
            )

    def in_cell_time(self, rate: float) -> ProcedureSettings:
        """The same with the ages of poses in the time of a cell that is `rate` times as fast as the machine.

        A pose is as long on the bus as ever, which is `rate` times as long for such a cell.
        """
        unseen = min(self.tracking.unseen * rate, LONGEST_UNSEEN)
        tracking = msgspec.structs.replace(self.tracking, unseen=unseen)
        return msgspec.structs.replace(self, max_pose_age=self.max_pose_age * rate, tracking=tracking)
