"""Limits, distances and calibrations of a placement procedure."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pcmrs.calibration import ToolType
from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform
from pcmrs.tms import IntervalSettings, MepSettings, ThresholdSettings
from pcmrs.tms.hotspot_settings import HotspotSettings

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = tuple[float, float, float]


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
    """What has been calibrated before the procedure: in files of `pcmrs calibrate`, or given here.

    Attributes:
        tool_file: Calibration file of the tool; in its place count `flange_from_tool` and `tool_from_coil` where empty.
        pointer_file: Calibration file of the pointer; in its place counts `pointer_from_tip` where empty.
        tool_serial: Of the tool that is mounted; a file of another one is refused. Empty for any.
        pointer_serial: The same of the pointer.
        flange_from_tool: The mount on the flange.
        tool_from_coil: The coil in its mount; +z of the coil points away from the body.
        pointer_from_tip: The tip in the pointer's marker body.
    """

    tool_file: str = ""
    pointer_file: str = ""
    tool_serial: str = ""
    pointer_serial: str = ""
    flange_from_tool: PoseSetting = PoseSetting((0.0, 0.0, 0.10))
    tool_from_coil: PoseSetting = PoseSetting((0.0, 0.0, 0.05), (0.0, 1.0, 0.0, 0.0))
    pointer_from_tip: PoseSetting = PoseSetting((0.0, 0.0, -0.15))


class RegistrationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a digitization and a registration are good enough; the defaults are those of a head with 6 landmarks.

    Attributes:
        residual_limit_mm: Largest mean distance of the landmarks that is accepted; 4.0 separates the
            published controls from the published failures with 6 head landmarks (4 of the femur: 2.7).
        sigma_mm: Noise of a landmark that is expected before any registration, standard deviation per axis: 1.86
            reproduces the published controls of the head (femur: 1.03).
        sigma_degrees: How many degrees of freedom that belief is worth: 24 is two registrations of 6 landmarks.
        tre_limit_mm: Largest predicted rms error at the target. The example plans have up to 3.1 on the head and 1.2 at
            the femur; 4.0 leaves room for targets between other landmarks, and refuses those beside them all. A hole is
            drilled once, so the femur's is 3.0.
        false_alarm: Share of good sets in which a landmark may be suspected, and of good touches taken for a shift.
        samples: Tracker frames averaged per touch.
        spread_limit_mm: Largest rms deviation of the samples of one touch.
        touch_timeout_s: Longest wait for the person to touch.
        surface_sigma_mm: Noise of a point touched on the skin, along its normal, the mesh's own error included.
        surface_trim: Part of these points that is believed.
        retouch_sigma_mm: Noise of touching one landmark again, standard deviation per axis: what of `sigma_mm` is not
            the fixed error of the plan (femur: 0.52).
        reference_limit_mm: How far the reference may shift against the witness: far above what the tracker's jitter and
            bias make of it, below what matters at a target.
        reference_limit_deg: The same for its rotation.
        reference_frames: So many frames in a row must show it.
    """

    residual_limit_mm: Positive = 4.0
    sigma_mm: Positive = 1.86
    sigma_degrees: Positive = 24.0
    tre_limit_mm: Positive = 4.0
    false_alarm: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.01
    samples: Annotated[int, msgspec.Meta(ge=2)] = 20
    spread_limit_mm: Positive = 1.0
    touch_timeout_s: Positive = 30.0
    surface_sigma_mm: Positive = 0.7
    surface_trim: Annotated[float, msgspec.Meta(ge=0.5, le=1.0)] = 0.9
    retouch_sigma_mm: Positive = 0.95
    reference_limit_mm: Positive = 1.5
    reference_limit_deg: Positive = 1.0
    reference_frames: Annotated[int, msgspec.Meta(ge=2)] = 6


class TrackingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a tracked pose is not believed.

    Attributes:
        error_mm: It fits worse than this to the geometry of its marker body.
        speed: The body went faster since the frame before, m/s: more than hand, head or arm do.
        turn: It turned faster, rad/s.
        steady: After that it is believed again when so many frames have shown no jump.
    """

    error_mm: Positive = 1.0
    speed: Positive = 2.0
    turn: Positive = 20.0
    steady: Annotated[int, msgspec.Meta(ge=1)] = 10


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


PressForce = Annotated[float, msgspec.Meta(ge=1.0, le=5.0)]
"""What a tool may be pressed on a body with, N."""


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


class ToolSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The tool's shape: a cylinder about its z axis, from the tool point along +z, away from the body; m."""

    kind: Literal["cylinder"] = "cylinder"
    radius: Positive = 0.05
    half_length: Positive = 0.01


class BoxSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Something fixed that the arm keeps out of.

    Attributes:
        name: As refusals have it.
        pose: Of its middle, in the robot's base.
        size: Edges along its axes, m.
    """

    name: str
    pose: PoseSetting
    size: tuple[Positive, Positive, Positive]


TABLE = BoxSettings("table", PoseSetting((0.4, 0.0, -0.145)), (1.4, 1.4, 0.05))
"""The bench of the simulated cell; a real one has its own."""


class ZoneSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What arm and tool keep out of, and the cone through which alone the tool comes to the body.

    Attributes:
        tool: What the flange carries.
        boxes: What stands fixed in the cell.
        body_margin: Distance of every link from the convex hull of the body's surface, m; the tool may touch it within
            `cone_height` of the target, which has to be more than this.
        box_margin: Distance of links and tool from every box, m.
        link_margin: Distance of links that are no neighbours from each other, m.
        sight_radius: How far links stay from what the tracker sees the tool and the body's reference along, m.
        cone_height: Distance from the target within which the tool point stays in the cone, m; below the standoff.
        cone_half_angle_deg: Between the cone and the tool's axis at the target.
        depth_limit: How far beyond the target the tool point may be, m.
        drift_limit: A motion is held where a link is nearer to a zone than planned and allowed by so much, m.

    Raises:
        ValueError: Two boxes have one name, or one that means something else.
    """

    tool: ToolSettings = ToolSettings()
    boxes: tuple[BoxSettings, ...] = (TABLE,)
    body_margin: NotNegative = 0.030
    box_margin: NotNegative = 0.020
    link_margin: NotNegative = 0.010
    sight_radius: Positive = 0.003
    cone_height: NotNegative = 0.060
    cone_half_angle_deg: Annotated[float, msgspec.Meta(gt=0.0, lt=90.0)] = 30.0
    depth_limit: NotNegative = 0.010
    drift_limit: Positive = 0.005

    def __post_init__(self) -> None:
        names = [box.name for box in self.boxes]
        taken = sorted({name for name in names if names.count(name) > 1 or name in RESERVED})
        if taken:
            raise ValueError(f"boxes need names of their own, which {', '.join(taken)} is not")


RESERVED = frozenset({"body", "base", "mount", "tool", "sight_of_tool", "sight_of_body"})
"""Names of zones and links that no box may have."""


class BodySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The surface of the body, which the arm keeps away from.

    Attributes:
        surface: File of a triangle mesh in image coordinates; none when empty. A name alone is looked for in `folders`
            and among the shipped examples.
        unit: Of its numbers.
        space: Of its axes.
        folders: Where to look, in order.
    """

    surface: str = ""
    unit: Literal["m", "mm"] = "m"
    space: Literal["RAS", "LPS"] = "RAS"
    folders: tuple[str, ...] = ()


class ProcedureSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``procedure`` of the configuration.

    Attributes:
        max_pose_age: A tracked pose older than this is stale, s of the cell's clock.
        home: Posture for `placement.home`, rad, base to flange; empty for the arm's own.
        patient: Whose registration it is; a previous registration of another patient is refused.
        tool: What the workflow places; the calibration file of another type of tool is refused.
        limits: Further limits of the workflow's own checks, by name; its blueprint's defaults name them all.
    """

    patient: str = "phantom"
    max_pose_age: Positive = 0.25
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
    zones: ZoneSettings = ZoneSettings()
    body: BodySettings = BodySettings()
    limits: dict[str, float] = {}
