"""The table ``scene_camera`` of the configuration: a depth camera, where it is, and which zones it watches."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pcmrs.workflows.settings import PoseSetting

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Vector = tuple[float, float, float]


class WatchedZone(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A watched box.

    Attributes:
        name: Name of the zone; the region of its events.
        middle: Middle of the box in the robot's base, m.
        size: Lengths of its edges along the axes of the base, m.
    """

    name: str
    middle: Vector
    size: tuple[Positive, Positive, Positive]


WORKSPACE = WatchedZone("workspace", (0.45, 0.0, 0.45), (1.1, 1.2, 1.0))
"""Space above the bench of the simulated cell. A real cell configures its own."""


ABOVE_THE_BENCH = PoseSetting((1.5, 0.0, 1.5), (0.270598, -0.653281, -0.653281, 0.270598))
"""Camera opposite the arm, 45 degrees down."""


class SceneCameraSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the detector `pcmrs-scene`.

    Attributes:
        driver: Driver of the camera of `pcmrs scene`: ``realsense``, or ``recorded`` for the images of a file.
        source: Name of the source in ``scene_events.sources``.
        label: Label of an object in a zone that is neither arm nor body.
        pose: Pose of the camera in the robot's base: z along the optical axis, x right in the image, y down.
        body: Pose of the image in the robot's base, for the surface ``procedure.body``. Without it, the body is known
            as a part of the background only.
        zones: Watched zones.
        background_frames: Number of images of the empty scene at the start.
        tolerance: Least distance of an object before the background, m.
        arm_margin: Distance from the model of the arm within which a point belongs to it, m.
        body_margin: Distance from the convex hull of the body within which a point belongs to it, m.
        voxel: Distance below which points are one object, m.
        least_points: Number of points from which an object counts.
        least_extent: Extent from which an object counts, m.
        gate: Distance that an object moves at most between two images, m.
        joints_age: Age of the measured joints from which the arm's place is not known, s.
        file: File of the recorded images, for ``recorded``.
        serial: Serial number of the RealSense; empty for the only one.
        width: Width of the images of the RealSense, pixels.
        height: Height of the images of the RealSense, pixels.
        rate_hz: Rate of the images of RealSense and simulation, Hz.
    """

    driver: Literal["realsense", "recorded"] = "realsense"
    source: str = "camera"
    label: str = "intrusion"
    pose: PoseSetting = ABOVE_THE_BENCH
    body: PoseSetting | None = None
    zones: tuple[WatchedZone, ...] = (WORKSPACE,)
    background_frames: Annotated[int, msgspec.Meta(ge=5, le=300)] = 10
    tolerance: Positive = 0.03
    arm_margin: NotNegative = 0.06
    body_margin: NotNegative = 0.04
    voxel: Positive = 0.03
    least_points: Annotated[int, msgspec.Meta(ge=1)] = 8
    least_extent: NotNegative = 0.04
    gate: Positive = 0.3
    joints_age: Positive = 0.3
    file: str = ""
    serial: str = ""
    width: int = 640
    height: int = 480
    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, le=90.0)] = 15.0
