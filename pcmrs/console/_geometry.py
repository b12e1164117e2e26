"""Positions, in the robot's base, of everything that the scene shows. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pcmrs.messages import BodyPose
from pcmrs.messages.setup import ArmShown, ProcedureDataView, Setup, SurfaceShown
from pcmrs.spatial import Floats, Transform, distance, rotation_angle
from pcmrs.workflows.data import as_transform

SHIFTED, TURNED = 0.02, 0.01
"""Deviation larger than noise, m and rad: the tracker was moved."""
SHARE = 0.05
"""Weight of a new measurement in the estimated pose of the tracker."""

FACES = 2500
"""Largest number of faces of a surface for display."""


@dataclass(frozen=True, slots=True)
class PlacementDeviation:
    """Deviation of the tool from its plan: the measured pose in the planned one.

    Attributes:
        mm: Distance of the tool points, and its components along the axes of the planned tool, mm, (4,).
        degrees: Angle between both, degrees.
    """

    mm: tuple[float, float, float, float]
    degrees: float


def vertices_of(surface: SurfaceShown) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return the vertices, m, (V, 3), and the faces, (F, 3)."""
    vertices = np.frombuffer(surface.vertices, "<f4").reshape(-1, 3).astype(float)
    return vertices, np.frombuffer(surface.faces, "<u4").reshape(-1, 3).astype(np.int64)


@lru_cache(maxsize=1)
def decimate(surface: SurfaceShown) -> SurfaceShown:
    """Return a surface of at most `FACES` for display: a browser without a graphics card cannot draw more in time."""
    vertices, faces = vertices_of(surface)
    if len(faces) <= FACES:
        return surface
    from trimesh import Trimesh

    mesh = Trimesh(vertices, faces, process=False).simplify_quadric_decimation(face_count=FACES)
    return SurfaceShown(
        vertices=np.asarray(mesh.vertices, "<f4").tobytes(), faces=np.asarray(mesh.faces, "<u4").tobytes()
    )


def as_stl(vertices: Floats, faces: npt.NDArray[np.int64]) -> bytes:
    """Return a mesh as binary STL for the browser.

    Args:
        vertices: Vertices, m, (V, 3).
        faces: Indices of the corners of each triangle, (F, 3).
    """
    from trimesh import Trimesh  # loads slowly, and is needed once for a page
    from trimesh.exchange.stl import export_stl

    return export_stl(Trimesh(vertices, faces, process=False))


def as_zone(vertices: Floats, margin: float) -> bytes:
    """Return the zone that the arm avoids around a body, as binary STL: the convex hull, widened by a margin.

    Args:
        vertices: Vertices of the body, m, (V, 3).
        margin: Distance from the hull, m.
    """
    from trimesh.convex import convex_hull
    from trimesh.creation import icosphere
    from trimesh.exchange.stl import export_stl

    outward = np.asarray(icosphere(subdivisions=2).vertices)
    farthest = vertices[np.argmax(vertices @ outward.T, axis=0)]
    return export_stl(convex_hull(farthest + margin * outward))


def along(axis: Floats) -> Floats:
    """Return a rotation (3, 3) that takes y to a unit vector (3,)."""
    x, y, z = axis.tolist()
    sine, angle = math.hypot(x, z), math.atan2(math.hypot(x, z), y)
    turn = (
        (angle / sine * z, 0.0, -angle / sine * x) if sine else (angle, 0.0, 0.0)
    )  # half a turn about any perpendicular axis
    return Transform.from_rotvec((0.0, 0.0, 0.0), turn).rotation


class ArmFrames:
    """Frames of the arm's joints.

    Args:
        shown: Description of the arm from the daemon.
    """

    def __init__(self, shown: ArmShown) -> None:
        self._fixed = [as_transform(each) for each in shown.joints]
        self._flange = as_transform(shown.flange)
        self.radius = shown.link_radius

    @property
    def spans(self) -> list[Floats]:
        """The vectors from each joint's origin to the next, and from the last to the flange, m, (n, 3).

        Each is in the frame of its joint.
        """
        return [each.translation for each in (*self._fixed[1:], self._flange)]

    def frames(self, positions: npt.ArrayLike) -> list[Transform]:
        """Return ``base_from_joint`` of all joints, and of the flange at the end, at joint positions rad, (n,)."""
        found: list[Transform] = []
        pose = Transform.identity()
        for fixed, angle in zip(self._fixed, np.asarray(positions, dtype=float).tolist(), strict=True):
            pose = pose @ fixed @ Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 0.0, angle))
            found.append(pose)
        return [*found, pose @ self._flange]


class TrackerLocator:
    """Relation between arm and tracker, by the tool, whose pose both of them know.

    The estimate is kept while the tool is not seen.

    Args:
        setup: Setup of the cell.

    Attributes:
        base_from_tracker: Estimate; None until tool and joints were known together.
    """

    def __init__(self, setup: Setup) -> None:
        self.arm = ArmFrames(setup.arm)
        self._flange_from_tool_tip = as_transform(setup.flange_from_coil)
        self.base_from_tracker: Transform | None = None

    def see(
        self, positions: npt.ArrayLike, tracker_from_tool_tip: Transform | None, *, moving: bool
    ) -> list[Transform]:
        """Take the present joints and pose of the tool, and return `ArmFrames.frames`.

        Args:
            positions: Joint positions, rad, (n,).
            tracker_from_tool_tip: Pose of the tool's contact point; None if the tool is not seen.
            moving: The arm moves, so that joints and pose are of different moments.
        """
        frames = self.arm.frames(positions)
        if tracker_from_tool_tip is not None and not moving:
            self._update_tracker_pose(frames[-1] @ self._flange_from_tool_tip @ tracker_from_tool_tip.inverse())
        return frames

    def _update_tracker_pose(self, found: Transform) -> None:
        """Update the estimated pose of the tracker.

        The estimate is filtered: over the tracker's distance, the noise of an angle is millimetres.
        """
        estimate = self.base_from_tracker
        if estimate is None or distance(estimate, found) > SHIFTED or rotation_angle(estimate, found) > TURNED:
            self.base_from_tracker = found
            return
        rest = estimate.inverse() @ found
        self.base_from_tracker = estimate @ Transform.from_rotvec(SHARE * rest.translation, SHARE * rest.rotvec)

    def in_base(self, body: BodyPose | None) -> Transform | None:
        """Return the pose, in the robot's base, of a body that the tracker sees."""
        if body is None or not body.valid or self.base_from_tracker is None:
            return None
        return self.base_from_tracker @ as_transform(body)


def tool_tip(setup: Setup, marker: BodyPose | None) -> Transform | None:
    """Return ``tracker_from_tool_tip``; None while the tool is not seen.

    Args:
        setup: Setup of the cell.
        marker: Pose of the tool's marker body in the tracker.
    """
    if marker is None or not marker.valid:
        return None
    return as_transform(marker) @ as_transform(setup.tool_marker_from_tool_tip)


def placement_deviation(
    data: ProcedureDataView, tracker_from_tool_tip: Transform | None, body_ref: BodyPose | None
) -> PlacementDeviation | None:
    """Return the deviation of the tool from its plan, as the tracker sees it; None while unknown.

    Args:
        data: Data of the procedure, with plan and registration.
        tracker_from_tool_tip: Pose of the tool's contact point; None if the tool is not seen.
        body_ref: Pose of the reference in the tracker.
    """
    if data.plan is None or data.body_ref_from_image is None:
        return None
    if tracker_from_tool_tip is None or body_ref is None or not body_ref.valid:
        return None
    tracker_from_planned = as_transform(body_ref) @ as_transform(data.body_ref_from_image) @ as_transform(data.plan)
    planned_from_measured = tracker_from_planned.inverse() @ tracker_from_tool_tip
    x, y, z = (1000.0 * planned_from_measured.translation).tolist()
    away = 1000.0 * distance(planned_from_measured, Transform.identity())
    angle = np.degrees(rotation_angle(planned_from_measured, Transform.identity()))
    return PlacementDeviation((away, x, y, z), float(angle))


def residuals(data: ProcedureDataView) -> list[float | None]:
    """Return the distance of each landmark from its digitized point, by the registration in force, m."""
    if data.body_ref_from_image is None:
        return [None] * len(data.landmarks)
    registered = as_transform(data.body_ref_from_image)
    return [
        None if each.digitized is None
        else float(np.linalg.norm(registered @ np.array(each.planned) - np.array(each.digitized)))
        for each in data.landmarks
    ]  # fmt: skip
