"""Limits, distances and calibrations of a placement procedure."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = tuple[float, float, float]
Seven = tuple[float, float, float, float, float, float, float]


class PoseSetting(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``a_from_b`` as configured: translation in m and unit quaternion.

    Raises:
        ValueError: It is no pose.
    """

    position: Triple = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        try:
            self.transform()
        except GeometryError as error:
            raise ValueError(error.text) from None  # to which msgspec adds the key

    def transform(self) -> Transform:
        """The same as a `Transform`."""
        return Transform.from_quat_wxyz(self.position, self.quat_wxyz)


class CalibrationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What has been calibrated before the procedure.

    Attributes:
        flange_from_tool: The mount on the flange.
        tool_from_coil: The coil in its mount; +z of the coil points away from the body.
        pointer_from_tip: The tip in the pointer's marker body.
    """

    flange_from_tool: PoseSetting = PoseSetting((0.0, 0.0, 0.10))
    tool_from_coil: PoseSetting = PoseSetting((0.0, 0.0, 0.05), (0.0, 1.0, 0.0, 0.0))
    pointer_from_tip: PoseSetting = PoseSetting((0.0, 0.0, -0.15))


class RegistrationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a digitization and a registration are good enough.

    Attributes:
        residual_limit_mm: Largest mean distance of the landmarks that is accepted; 4.0 separates the
            published controls from the published failures with 6 head landmarks.
        samples: Tracker frames averaged per landmark.
        spread_limit_mm: Largest rms deviation of the samples of one landmark.
        touch_timeout_s: Longest wait for the person to touch a landmark.
    """

    residual_limit_mm: Positive = 4.0
    samples: Annotated[int, msgspec.Meta(ge=2)] = 20
    spread_limit_mm: Positive = 1.0
    touch_timeout_s: Positive = 30.0


class MotionSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Speed limits of every motion; the arm's own limits hold as well.

    Attributes:
        linear_velocity: Of the flange, m/s.
        joint_speed_fraction: Fraction of the data sheet's joint velocities.
    """

    linear_velocity: Positive = 0.20
    linear_acceleration: Positive = 0.5
    linear_jerk: Positive = 3.0
    angular_velocity: Positive = 0.6
    angular_acceleration: Positive = 1.5
    joint_speed_fraction: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.35
    joint_acceleration: Positive = 2.5
    joint_jerk: Positive = 15.0


class PlacementSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the tool is brought to the body and away from it.

    Attributes:
        standoff: Distance along the tool's +z axis at which an approach ends, m.
        confirm_offset: Distance at which `confirm` ends, m; errors subtract it.
        clearance: A tool farther than this from the middle of the body is clear of it, m.
        settle_time: Rest before a measurement, s.
        frames: Tracker frames averaged per measurement.
        correction_limit_mm: Largest correction of the command that is believed.
        correction_limit_deg: The same for its rotation.
        standoff_tolerance_mm: How far from the plan's standoff a retreat may end to count as there.
        nudge_limit_mm: Largest total nudge.
        nudge_limit_deg: The same for its rotation.

    Raises:
        ValueError: `confirm_offset` is not below `standoff`: confirming would lead away from the body.
    """

    standoff: Positive = 0.070
    confirm_offset: NotNegative = 0.0
    clearance: Positive = 0.28
    settle_time: NotNegative = 0.3
    frames: Annotated[int, msgspec.Meta(ge=1)] = 30
    correction_limit_mm: Positive = 5.0
    correction_limit_deg: Positive = 2.0
    standoff_tolerance_mm: Positive = 5.0
    nudge_limit_mm: Positive = 20.0
    nudge_limit_deg: Positive = 10.0

    def __post_init__(self) -> None:
        if not self.confirm_offset < self.standoff:
            raise ValueError(f"confirm_offset is {self.confirm_offset:g} m, but standoff is only {self.standoff:g} m")


class ProcedureSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``procedure`` of the configuration.

    Attributes:
        max_pose_age: A tracked pose older than this is stale, s of the cell's clock.
        home: Posture for `placement.home`, rad, base to flange.
        patient: Whose registration it is; a previous registration of another patient is refused.
        limits: Further limits of the workflow's own checks, by name; its blueprint's defaults name them all.
    """

    patient: str = "phantom"
    max_pose_age: Positive = 0.25
    home: Seven = (0.0, -0.35, 0.0, -1.57, 0.0, 1.40, -1.57)
    calibration: CalibrationSettings = CalibrationSettings()
    registration: RegistrationSettings = RegistrationSettings()
    motion: MotionSettings = MotionSettings()
    placement: PlacementSettings = PlacementSettings()
    limits: dict[str, float] = {}
