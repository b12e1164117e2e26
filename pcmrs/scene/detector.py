"""Detection of intrusions in depth images of a fixed camera: background, known bodies, clusters, tracks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pcmrs.scene._background import Background
from pcmrs.scene._clusters import BoxZone, find_clusters
from pcmrs.scene._tracking import Track, Tracker
from pcmrs.scene.camera_settings import SceneCameraSettings, WatchedZone
from pcmrs.scene.depth_frame import DepthFrame, Image, Intrinsics, points_of
from pcmrs.scene.known_bodies import KnownBodies
from pcmrs.spatial import Transform

Joints = npt.ArrayLike


@dataclass(frozen=True, slots=True)
class SceneView:
    """View of one image.

    Attributes:
        blind: Why the scene cannot be seen; empty if it can.
        tracks: Objects in zones, with their tracks.
    """

    blind: str = ""
    tracks: list[Track] = field(default_factory=list)


class IntrusionDetector:
    """Detector of what is in the zones and is neither background, arm nor body.

    The background must be learned with nobody in the scene; the arm may stand anywhere, since its pixels are left out.

    Args:
        settings: Settings of camera and zones.
        intrinsics: Pinhole model of the camera.
        bodies: Models of arm and body.
    """

    def __init__(self, settings: SceneCameraSettings, intrinsics: Intrinsics, bodies: KnownBodies) -> None:
        self._settings = settings
        self._rays = intrinsics.rays()
        self._bodies = bodies
        self._base_from_camera = settings.pose.transform()
        self._zones = [_box(zone) for zone in settings.zones]
        self._tracker = Tracker(settings.gate)
        self._empty: list[Image] = []
        self._hidden = np.zeros((intrinsics.height, intrinsics.width), dtype=np.float32)
        self._background: Background | None = None
        self._number: int | None = None

    @property
    def learned(self) -> bool:
        """True if the background is known."""
        return self._background is not None

    def look(self, frame: DepthFrame, joints: Joints | None) -> SceneView:
        """Look at an image.

        Args:
            frame: The image.
            joints: Joints of the arm at its time, rad; None if they are not known.

        Raises:
            GeometryError: The background cannot be learned; the text says why.
        """
        if frame.number == self._number:
            return SceneView("frozen")
        self._number = frame.number
        if joints is None:
            return SceneView("no_joints")
        depth = np.where(np.isfinite(frame.depth), frame.depth, 0.0).astype(np.float32)
        if self._background is None:
            return self._learn(depth, joints)
        return self._find(self._background, depth, joints)

    def _learn(self, depth: Image, joints: Joints) -> SceneView:
        """Learn the background without the arm, which will move away from where it stands."""
        arm = self._explained(depth, depth > 0.0, joints)
        self._empty.append(np.where(arm, 0.0, depth).astype(np.float32))
        self._hidden = np.maximum(self._hidden, np.where(arm, depth, 0.0)).astype(np.float32)
        if len(self._empty) >= self._settings.background_frames:
            self._background = Background(np.array(self._empty), self._hidden, self._settings.tolerance)
            self._empty.clear()
        return SceneView("learning")

    def _find(self, background: Background, depth: Image, joints: Joints) -> SceneView:
        settings, before, revealed = self._settings, background.before(depth), background.hidden_before(depth)
        explained = self._explained(depth, before | revealed, joints)
        blind = background.trouble(depth, explained)
        if blind:
            return SceneView(blind)
        points = points_of(depth, self._rays, before & ~explained, self._base_from_camera)
        clusters = find_clusters(
            points,
            self._zones,
            voxel=settings.voxel,
            least_points=settings.least_points,
            least_extent=settings.least_extent,
        )
        found = list(clusters)
        if not found:  # nobody is there, so what the arm does not hide any more was there from the beginning
            background.reveal(depth, revealed & ~explained)
        return SceneView(tracks=self._tracker.update(found))

    def _explained(self, depth: Image, chosen: npt.NDArray[np.bool_], joints: Joints) -> npt.NDArray[np.bool_]:
        """Return the chosen pixels that show arm or body, (height, width)."""
        found = np.zeros_like(chosen)
        found[chosen] = self._bodies.explain(points_of(depth, self._rays, chosen, self._base_from_camera), joints)
        return found


def _box(zone: WatchedZone) -> BoxZone:
    return BoxZone(zone.name, Transform.from_quat_wxyz(zone.middle, (1.0, 0.0, 0.0, 0.0)), np.array(zone.size))
