"""Settings of calibration and registration, and limits of valid tracked poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from pcmrs.calibration import ToolType
from pcmrs.workflows.settings._values import Length, PoseSetting, Positive, WholePoseSetting

if TYPE_CHECKING:
    from pcmrs.registration.surface import OffsetPrior

SIMULATED_FLANGE_FROM_TOOL_MARKER = WholePoseSetting((-0.06, -0.066, 0.138), (0.4, 0.8, 0.4, -0.2))
"""Marker body of the simulated tool on the flange."""
SIMULATED_TOOL_MARKER_FROM_TOOL_TIP = WholePoseSetting((0.06, 0.03, -0.06), (0.8, 0.4, 0.2, 0.4))
"""Contact point of the simulated tool in its marker body: 90 mm away, and rotated about all axes."""


class CalibrationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Calibrations made before the procedure, as files of `pcmrs calibrate` or as poses.

    The tool needs two: its marker body on the flange, and its contact point in the marker body. If neither is given,
    the poses are those of the simulated tool.

    Attributes:
        tool_file: Calibration file of the marker body on the flange. If empty, `flange_from_tool_marker` is used.
        tip_file: Calibration file of the contact point. If empty, `tool_marker_from_tool_tip` is used.
        pointer_file: Calibration file of the pointer. If empty, `pointer_from_tip` is used.
        tool_serial: Serial number of the mounted tool. The files of another one are refused. Empty for any.
        pointer_serial: Serial number of the pointer. The file of another one is refused. Empty for any.
        reference_serial: Serial number of the marker body on the patient. Digitizations, registrations and plans made
            with another one cannot be reused.
        flange_from_tool_marker: Pose of the tool's marker body on the flange, m and quaternion.
        tool_marker_from_tool_tip: Contact point and axes of the tool in its marker body, m and quaternion. The +z axis
            points away from the body. Give the identity explicitly if marker body and contact point coincide.
        pointer_from_tip: Pose of the tip in the pointer's marker body, m and quaternion.

    Raises:
        ValueError: Only one of marker body and contact point is given, or one of them twice.
    """

    tool_file: str = ""
    tip_file: str = ""
    pointer_file: str = ""
    tool_serial: str = ""
    pointer_serial: str = ""
    reference_serial: str = ""
    flange_from_tool_marker: WholePoseSetting | None = None
    tool_marker_from_tool_tip: WholePoseSetting | None = None
    pointer_from_tip: PoseSetting = PoseSetting((0.0, 0.0, -0.15))

    def __post_init__(self) -> None:
        marker = bool(self.tool_file) + (self.flange_from_tool_marker is not None)
        tip = bool(self.tip_file) + (self.tool_marker_from_tool_tip is not None)
        if marker > 1:
            raise ValueError("tool_file and flange_from_tool_marker are both given: give one of them")
        if tip > 1:
            raise ValueError("tip_file and tool_marker_from_tool_tip are both given: give one of them")
        if marker and not tip:
            raise ValueError(
                "the marker body of the tool is given, but not its contact point: make tip_file with `pcmrs calibrate "
                "tip`, or give tool_marker_from_tool_tip; the identity must be given, too"
            )
        if tip and not marker:
            raise ValueError(
                "the contact point of the tool is given, but not its marker body on the flange: make tool_file with "
                "`pcmrs calibrate hand-eye`, or give flange_from_tool_marker"
            )

    @property
    def of_simulated_tool(self) -> bool:
        """True if nothing is given for the tool, so that the poses of the simulated one are used."""
        return not self.tool_file and self.flange_from_tool_marker is None


class RegistrationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of digitization and registration. The defaults are those of a head with 6 landmarks.

    Attributes:
        residual_limit_mm: Largest accepted mean distance of the landmarks, mm. 4.0 separates the published controls
            from the published failures with 6 head landmarks (with 4 landmarks of the femur: 2.7).
        sigma_mm: Expected noise of a landmark before any registration, standard deviation per axis, mm. 1.86 reproduces
            the published controls of the head (femur: 1.03).
        sigma_degrees: Degrees of freedom that this expectation is worth: 24 is two registrations of 6 landmarks.
        tre_limit_mm: Largest predicted rms error at the target, mm. The example plans have up to 3.1 on the head and
            1.2 at the femur. 4.0 leaves room for targets between other landmarks, and refuses those beside all
            landmarks. A hole is drilled only once, so the limit of the femur is 3.0.
        false_alarm: Share of good sets in which a landmark may be suspected, and of good touches taken for a shift.
        samples: Number of tracker frames averaged per touch.
        spread_limit_mm: Largest rms deviation of the samples of one touch, mm.
        touch_timeout_s: Longest wait for a touch, s.
        surface_sigma_mm: Noise of a point touched on the skin along its normal, including the mesh's error, mm.
        surface_trim: Share of these points that is used.
        surface_offsets: Common offsets of these points along the normal that are estimated: none (on bare bone), one
            for all points, one for the hair, one for the face, or one for each of the two. By tool: one for each if
            the tool is a coil, which is placed on a head, otherwise none.
        surface_hair_mm: Expected offset of points in the hair, or of all points if there is one offset, outwards, mm.
        surface_hair_sigma_mm: Standard deviation of this expectation, mm.
        surface_face_mm: Expected offset of points on the bare face, outwards, mm.
        surface_face_sigma_mm: Standard deviation of this expectation, mm.
        surface_offset_limit_mm: Largest accepted estimate of an offset in either direction, mm: beyond it, the mesh is
            wrong or the hair has to be parted.
        retouch_sigma_mm: Noise of a second touch of one landmark, standard deviation per axis, mm: the part of
            `sigma_mm` that is not the fixed error of the plan (femur: 0.52).
        reference_limit_mm: Largest shift of the reference against the witness, mm: far above the effect of the
            tracker's jitter and bias, and below what matters at a target.
        reference_limit_deg: Largest rotation of the reference against the witness, deg.
        reference_frames: Number of successive frames that must show the shift.

    Raises:
        ValueError: An expected offset is beyond the limit of an estimated one.
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
    surface_offsets: Literal["by_tool", "none", "everywhere", "hair", "face", "hair_and_face"] = "by_tool"
    surface_hair_mm: float = 2.0
    surface_hair_sigma_mm: Positive = 3.0
    surface_face_mm: float = 0.0
    surface_face_sigma_mm: Positive = 1.0
    surface_offset_limit_mm: Positive = 8.0
    retouch_sigma_mm: Positive = 0.95
    reference_limit_mm: Positive = 1.5
    reference_limit_deg: Positive = 1.0
    reference_frames: Annotated[int, msgspec.Meta(ge=2)] = 6

    def __post_init__(self) -> None:
        for region in ("hair", "face"):
            expected = getattr(self, f"surface_{region}_mm")
            if not abs(expected) <= self.surface_offset_limit_mm:
                raise ValueError(
                    f"registration.surface_{region}_mm is {expected:g}, beyond surface_offset_limit_mm, which is "
                    f"{self.surface_offset_limit_mm:g}"
                )

    def offset_priors(self, tool: ToolType) -> tuple[OffsetPrior, ...]:
        """Return the priors of the offsets that `surface_offsets` names.

        Args:
            tool: Type of the tool that the workflow places.
        """
        from pcmrs.registration.surface import OffsetPrior  # loads numpy, which clients that read settings do without

        limit = self.surface_offset_limit_mm / 1000.0
        hair = self.surface_hair_mm / 1000.0, self.surface_hair_sigma_mm / 1000.0, limit
        face = self.surface_face_mm / 1000.0, self.surface_face_sigma_mm / 1000.0, limit
        by_tool = "hair_and_face" if tool == "coil" else "none"
        match by_tool if self.surface_offsets == "by_tool" else self.surface_offsets:
            case "none":
                return ()
            case "everywhere":
                return (OffsetPrior("everywhere", *hair),)
            case "hair":
                return (OffsetPrior("hair", *hair),)
            case "face":
                return (OffsetPrior("face", *face),)
            case _:
                return OffsetPrior("hair", *hair), OffsetPrior("face", *face)


class VolumeSlice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A rectangle across the tracker's measuring volume.

    Attributes:
        distance: Distance from the tracker along its -z axis, m.
        width: Size along the tracker's x axis, m.
        height: Size along the tracker's y axis, m.
    """

    distance: Length
    width: Length
    height: Length


LONGEST_UNSEEN = 5.0
"""Longest time that a motion may continue while the tracker does not show the body, s of the cell."""


class TrackingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of valid tracked poses, and the tracker's measuring volume.

    Attributes:
        error_mm: Largest misfit of a pose to the geometry of its marker body, mm.
        speed: Largest speed of the body since the previous frame, m/s: faster than hand, head or arm.
        turn: Largest angular speed of the body since the previous frame, rad/s.
        steady: Number of frames without a jump after which poses are valid again.
        unseen: Time without a view of the body after which a motion towards it is held, s of the machine; at most 5 s
            of the cell, however fast the cell is.
        volume: The tracker's measuring volume from near to far, as its maker states it, for display only. Empty if it
            is not known.
    """

    error_mm: Positive = 1.0
    speed: Positive = 2.0
    turn: Positive = 20.0
    steady: Annotated[int, msgspec.Meta(ge=1)] = 10
    unseen: Annotated[float, msgspec.Meta(ge=0.1, le=LONGEST_UNSEEN)] = 0.5
    volume: tuple[VolumeSlice, ...] = ()
