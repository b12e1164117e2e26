"""How the tool is moved, brought to its place, kept there and pressed on."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.workflows.settings.values import NotNegative, Positive

PressForce = Annotated[float, msgspec.Meta(ge=1.0, le=5.0)]
"""What a tool may be pressed on a body with, N."""


class MotionSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Speed limits of every motion; the arm's own limits hold as well.

    Attributes:
        linear_velocity: Of the flange, m/s.
        joint_speed_fraction: Fraction of the data sheet's joint velocities.
        near_distance: From the surface of the body, m; what is nearer than this moves the tool slower.
        near_velocity: Of flange and tool point there, m/s; the last way to the target is never faster.
    """

    linear_velocity: Positive = 0.20
    linear_acceleration: Positive = 0.5
    linear_jerk: Positive = 3.0
    angular_velocity: Positive = 0.6
    angular_acceleration: Positive = 1.5
    joint_speed_fraction: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.35
    joint_acceleration: Positive = 2.5
    joint_jerk: Positive = 15.0
    near_distance: NotNegative = 0.10
    near_velocity: Positive = 0.05


class PlacementSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the tool is brought to the body and away from it.

    Attributes:
        standoff: Distance along the tool's +z axis at which an approach ends, m.
        confirm_offset: Distance at which `confirm` ends, m; errors subtract it.
        clearance: A tool farther than this from the middle of the body is clear of it, m.
        settle_time: Rest before a measurement, s.
        frames: Tracker frames averaged per measurement: the mean of 60 is uncertain by about 0.01 mm and 0.005° per
            axis.
        tolerance_mm: The tool counts as at the target when the tracker measures it nearer than this: less than what the
            tracker itself is off by, and a few times the noise of one measurement.
        tolerance_deg: The same for its rotation.
        corrections: So often the command is corrected at most.
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
    frames: Annotated[int, msgspec.Meta(ge=1)] = 60
    tolerance_mm: Positive = 0.08
    tolerance_deg: Positive = 0.03
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
    """When the tool is near enough to its planned pose to treat: two thresholds each, so that it does not flicker.

    Attributes:
        on_mm: At most so far from the planned pose, and
        on_deg: turned at most so much against it
        on_time: for so long, s, makes alignment 1.
        off_mm: Farther away than this, or
        off_deg: turned more than this, or not seen,
        off_time: for so long, s, makes it 0.

    Raises:
        ValueError: It would be lost more easily than gained.
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
    """How the tool follows the body.

    Attributes:
        period: Between two set points, s.
        lead: From a set point until the arm is there, s: so far ahead the body's pose is predicted, beyond the
            tracker's latency.
        farthest_lead: The body is predicted so far ahead at most, m: what breathes or drifts goes less meanwhile, and
            where a body that jerks will stop nobody knows.
        compensated: Whether it is predicted at all; otherwise the tool goes where the body was.
        smoothing_time: Time constant in which the tool goes to its place on the body, while it moves with it, s: it
            keeps the tracker's noise from shaking the arm.
        longest_gap: A pose older than this is not extrapolated, s: the tracker's latency and 0.1 s of occlusion.
        linear_velocity: Of the tool at most, m/s; behind a quicker body it lags, and alignment is lost.
        angular_velocity: The same for its rotation, rad/s.
        linear_acceleration: Of the tool at most, m/s^2: it can brake within what it catches up in.
        angular_acceleration: The same for its rotation, rad/s^2.
        correction_time: Time constant in which a constant error of the arm is corrected by the tracker, s.
        range: The body may go so far from where it was when following began, m.
    """

    period: Annotated[float, msgspec.Meta(gt=0.0, le=0.016)] = 0.010
    lead: NotNegative = 0.010
    farthest_lead: Positive = 0.0005
    compensated: bool = True
    smoothing_time: Positive = 0.05
    longest_gap: Annotated[float, msgspec.Meta(gt=0.0, le=0.2)] = 0.15
    linear_velocity: Positive = 0.10
    angular_velocity: Positive = 0.6
    linear_acceleration: Positive = 1.0
    angular_acceleration: Positive = 5.0
    correction_time: Positive = 1.0
    range: Positive = 0.100


class ContactSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the tool is pressed on the body.

    Attributes:
        force: Where the operator asks for none, N.
        travel: Farthest way towards the body from where the tool is, m: planned on the skin, it is off by as much as
            the registration is, some mm; no deeper than `zones.depth_limit` in any case.
        speed: Greatest speed, m/s.
        timeout: Longest time, s.
    """

    force: PressForce = 2.0
    travel: Annotated[float, msgspec.Meta(gt=0.0, le=0.010)] = 0.008
    speed: Annotated[float, msgspec.Meta(gt=0.0, le=0.05)] = 0.010
    timeout: Annotated[float, msgspec.Meta(gt=0.0, le=20.0)] = 15.0
