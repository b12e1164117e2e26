"""Limits, distances and calibrations of a placement procedure."""

from __future__ import annotations

import msgspec

from pcmrs.calibration import ToolType
from pcmrs.workflows.settings._measuring import (
    LONGEST_UNSEEN,
    SIMULATED_FLANGE_FROM_TOOL_MARKER,
    SIMULATED_TOOL_MARKER_FROM_TOOL_TIP,
    CalibrationSettings,
    RegistrationSettings,
    TrackingSettings,
)
from pcmrs.workflows.settings._moving import (
    AlignmentSettings,
    ContactSettings,
    FollowingSettings,
    MotionSettings,
    PlacementSettings,
    PressForce,
)
from pcmrs.workflows.settings._stimulation import StimulationSettings
from pcmrs.workflows.settings._teleoperation import TeleoperationSettings
from pcmrs.workflows.settings._values import PoseSetting, Positive, WholePoseSetting
from pcmrs.workflows.settings._zones import TABLE, BodySettings, BoxSettings, ToolSettings, ZoneSettings

__all__ = [
    "SIMULATED_FLANGE_FROM_TOOL_MARKER",
    "SIMULATED_TOOL_MARKER_FROM_TOOL_TIP",
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
    "WholePoseSetting",
    "ZoneSettings",
]


class ProcedureSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``procedure`` of the configuration.

    Attributes:
        patient: Name of the patient. A previous registration or plan of another patient is refused.
        operator: Name of the responsible person, for the records. No decision depends on it.
        max_pose_age: Age from which on a tracked pose is stale, s of the machine.
        abandoned_after: Time without any command, while the tool is at the body or a stimulator is armed, after which
            the session is held, s of the machine.
        home: Posture for `placement.home`, rad, base to flange; empty for the arm's own.
        calibration: Calibration files, or poses in their place.
        tool: Type of the tool that the workflow places. The calibration file of another type of tool is refused.
        tracking: Limits of valid tracked poses.
        registration: Limits of digitization and registration.
        motion: Speed limits of every motion.
        placement: Approach, retreat, and measurement of the tool's pose.
        alignment: Thresholds of alignment.
        following: Following of a moving body.
        contact: Pressing on the body.
        stimulation: Conditions of a pulse, and use of its response.
        teleoperation: Guiding by a teleoperator.
        zones: Zones that the arm keeps out of.
        body: Surface of the body.
        limits: Further limits of the workflow's own checks, by name. The defaults of its blueprint name all of them.

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
        """Return these settings with the ages of poses converted to the time of a faster cell.

        A pose takes the same time on the bus, which is `rate` times as long for such a cell.

        Args:
            rate: Speed of the cell's clock relative to that of the machine.
        """
        unseen = min(self.tracking.unseen * rate, LONGEST_UNSEEN)
        tracking = msgspec.structs.replace(self.tracking, unseen=unseen)
        return msgspec.structs.replace(self, max_pose_age=self.max_pose_age * rate, tracking=tracking)
