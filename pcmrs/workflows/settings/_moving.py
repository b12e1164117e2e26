"""Settings of the tool's motion: approach, alignment, following and pressing."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.workflows.settings._values import Length, LengthOrZero, NotNegative, Positive

PressForce = Annotated[float, msgspec.Meta(ge=1.0, le=5.0)]
"""Force with which a tool may be pressed on a body, N."""


class MotionSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Speed limits of every motion; the arm's own limits hold as well.

    Attributes:
        linear_velocity: Greatest speed of flange and tool point, m/s.
        linear_acceleration: Greatest acceleration of the tool point, m/s^2.
        linear_jerk: Greatest jerk of the tool point, m/s^3.
        angular_velocity: Greatest angular speed of the tool, rad/s.
        angular_acceleration: Greatest angular acceleration of the tool, rad/s^2.
        joint_speed_fraction: Fraction of the data sheet's joint speeds.
        joint_acceleration: Greatest acceleration of every joint, rad/s^2.
        joint_jerk: Greatest jerk of every joint, rad/s^3.
        near_distance: Distance from the surface of the body within which motions are slower, m.
        near_velocity: Greatest speed of flange and tool point there, m/s. The last part of the path to the target is
            never faster.
    """

    linear_velocity: Positive = 0.20
    linear_acceleration: Positive = 0.5
    linear_jerk: Positive = 3.0
    angular_velocity: Positive = 0.6
    angular_acceleration: Positive = 1.5
    joint_speed_fraction: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.35
    joint_acceleration: Positive = 2.5
    joint_jerk: Positive = 15.0
    near_distance: LengthOrZero = 0.10
    near_velocity: Positive = 0.05


class PlacementSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Approach of the tool to the body, retreat from it, and measurement of its pose.

    Attributes:
        standoff: Distance along the tool's +z axis at which an approach ends, m.
        confirm_offset: Distance along the tool's +z axis at which `confirm` ends, m. Errors are measured from there.
        confirm_drops_nudges: True if `confirm` goes to the planned pose without the nudges; False to keep them.
        keep_initial_posture: True if the posture that a panel has remembered as the initial one holds after a restart;
            False to begin with the home posture.
        clearance: Distance from the middle of the body beyond which the tool is clear of it, m.
        settle_time: Rest before a measurement, s.
        frames: Number of tracker frames averaged per measurement. The mean of 60 is uncertain by about 0.01 mm and
            0.005° per axis.
        tolerance_mm: Measured distance within which the tool is at its target, mm, with a tracker whose noise is small.
        tolerance_deg: Measured angle within which the tool is at its target, deg, with such a tracker.
        noise_factor: Multiple of the tracker's noise at rest within which the tool is at its target, too, up to 0.5 mm
            and 0.2°. With 0, only `tolerance_mm` and `tolerance_deg` count.
        repeatability_mm: Pose repeatability of the arm by its data sheet (ISO 9283), mm: no correction is more exact.
            It adds to the noise, as independent errors do.
        corrections: Greatest number of corrections of the command.
        correction_limit_mm: Largest plausible correction of the command, mm.
        correction_limit_deg: Largest plausible rotation of a correction, deg.
        standoff_tolerance_mm: Distance from the plan's standoff within which a retreat counts as ended there, mm.
        nudge_limit_mm: Largest sum of nudges, mm.
        nudge_limit_deg: Largest sum of rotations by nudges, deg.

    Raises:
        ValueError: `confirm_offset` is not below `standoff`, so that confirming would lead away from the body.
    """

    standoff: Length = 0.070
    confirm_offset: LengthOrZero = 0.0
    confirm_drops_nudges: bool = False
    keep_initial_posture: bool = False
    clearance: Length = 0.28
    settle_time: NotNegative = 0.3
    frames: Annotated[int, msgspec.Meta(ge=1)] = 60
    tolerance_mm: Positive = 0.08
    tolerance_deg: Positive = 0.03
    noise_factor: NotNegative = 2.0
    repeatability_mm: NotNegative = 0.0
    corrections: Annotated[int, msgspec.Meta(ge=1)] = 3
    correction_limit_mm: Positive = 5.0
    correction_limit_deg: Positive = 2.0
    standoff_tolerance_mm: Positive = 5.0
    nudge_limit_mm: Positive = 20.0
    nudge_limit_deg: Positive = 10.0

    def __post_init__(self) -> None:
        if not self.confirm_offset < self.standoff:
            raise ValueError(f"confirm_offset is {self.confirm_offset:g} m, but standoff is only {self.standoff:g} m")


class AlignmentSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds of alignment, the state in which the tool is near enough to its planned pose to treat.

    There are two thresholds each, so that alignment does not flicker.

    Attributes:
        on_mm: Largest distance from the planned pose at which alignment is gained, mm.
        on_deg: Largest angle to the planned pose at which alignment is gained, deg.
        on_time: Time within both thresholds after which alignment is gained, s.
        off_mm: Distance from the planned pose above which alignment is lost, mm.
        off_deg: Angle to the planned pose above which alignment is lost, deg.
        off_time: Time beyond one of these thresholds, or without a view of the tool, after which alignment is lost, s.

    Raises:
        ValueError: The thresholds of loss are below those of gain.
    """

    on_mm: Positive = 1.0
    on_deg: Positive = 2.0
    on_time: NotNegative = 0.5
    off_mm: Positive = 1.5
    off_deg: Positive = 3.0
    off_time: NotNegative = 0.1

    def __post_init__(self) -> None:
        if self.off_mm < self.on_mm or self.off_deg < self.on_deg:
            raise ValueError("off_mm and off_deg must not be smaller than on_mm and on_deg")


class FollowingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Following of a body that moves.

    Attributes:
        period: Time between two set points, s.
        lead: Time from a set point until the arm reaches it, s. The body's pose is predicted by this and the tracker's
            latency.
        farthest_lead: Largest predicted motion of the body, m. Breathing and drift move it less meanwhile, and the end
            of a jerk cannot be predicted.
        compensated: True if the pose is predicted; otherwise the tool goes where the body was.
        smoothing_time: Time constant with which the tool goes to its place on the body while it moves with the body,
            s. It keeps the tracker's noise from shaking the arm.
        longest_gap: Age up to which a pose is extrapolated, s: the tracker's latency and 0.1 s of occlusion.
        linear_velocity: Greatest speed of the tool, m/s. It lags behind a faster body, and alignment is lost.
        angular_velocity: Greatest angular speed of the tool, rad/s.
        linear_acceleration: Greatest acceleration of the tool, m/s^2. It can brake within the distance that it catches
            up.
        angular_acceleration: Greatest angular acceleration of the tool, rad/s^2.
        correction_time: Time constant with which the tracker corrects a constant error of the arm, s.
        range: Largest distance of the body from its place at the start, m.
    """

    period: Annotated[float, msgspec.Meta(gt=0.0, le=0.016)] = 0.010
    lead: NotNegative = 0.010
    farthest_lead: Length = 0.0005
    compensated: bool = True
    smoothing_time: Positive = 0.05
    longest_gap: Annotated[float, msgspec.Meta(gt=0.0, le=0.2)] = 0.15
    linear_velocity: Positive = 0.10
    angular_velocity: Positive = 0.6
    linear_acceleration: Positive = 1.0
    angular_acceleration: Positive = 5.0
    correction_time: Positive = 1.0
    range: Length = 0.100


class ContactSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Pressing of the tool on the body.

    Attributes:
        force: Force if the operator gives none, N.
        travel: Longest travel towards the body, m. It must cover the error of the registration, which is some mm. The
            tool never goes deeper than `zones.depth_limit`.
        speed: Greatest speed, m/s.
        timeout: Longest duration, s.
    """

    force: PressForce = 2.0
    travel: Annotated[float, msgspec.Meta(gt=0.0, le=0.010)] = 0.008
    speed: Annotated[float, msgspec.Meta(gt=0.0, le=0.05)] = 0.010
    timeout: Annotated[float, msgspec.Meta(gt=0.0, le=20.0)] = 15.0
