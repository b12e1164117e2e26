"""Calibration, registration, and when a tracked pose is believed."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.workflows.settings.values import PoseSetting, Positive


class CalibrationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What has been calibrated before the procedure: in files of `pcmrs calibrate`, or given here.

    Attributes:
        tool_file: Calibration file of the tool; in its place count `flange_from_tool` and `tool_from_coil` where empty.
        pointer_file: Calibration file of the pointer; in its place counts `pointer_from_tip` where empty.
        tool_serial: Of the tool that is mounted; a file of another one is refused. Empty for any.
        pointer_serial: The same of the pointer.
        reference_serial: Of the marker body on the patient; what was made with another one is not taken back.
        flange_from_tool: The mount on the flange.
        tool_from_coil: The coil in its mount; +z of the coil points away from the body.
        pointer_from_tip: The tip in the pointer's marker body.
    """

    tool_file: str = ""
    pointer_file: str = ""
    tool_serial: str = ""
    pointer_serial: str = ""
    reference_serial: str = ""
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


class VolumeSlice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A rectangle across the tracker's measuring volume: `distance` along its -z, width along x, height along y, m."""

    distance: Positive
    width: Positive
    height: Positive


LONGEST_UNSEEN = 5.0
"""A motion goes on for so long at most while the tracker does not show the body, s of the cell."""


class TrackingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a tracked pose is not believed, and where the tracker measures.

    Attributes:
        error_mm: It fits worse than this to the geometry of its marker body.
        speed: The body went faster since the frame before, m/s: more than hand, head or arm do.
        turn: It turned faster, rad/s.
        steady: After that it is believed again when so many frames have shown no jump.
        unseen: A motion towards the body is held when the tracker has not shown the body for so long, s of the
            machine; at most 5 s of the cell, however fast that is.
        volume: Where the tracker measures, near to far, as its maker says; only shown. Empty where nobody has said.
    """

    error_mm: Positive = 1.0
    speed: Positive = 2.0
    turn: Positive = 20.0
    steady: Annotated[int, msgspec.Meta(ge=1)] = 10
    unseen: Annotated[float, msgspec.Meta(ge=0.1, le=LONGEST_UNSEEN)] = 0.5
    volume: tuple[VolumeSlice, ...] = ()
