"""Depth images, and the points that they show."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform

__all__ = ["DepthCamera", "DepthFrame", "Intrinsics"]

Image = npt.NDArray[np.float32]
"""Depth along the optical axis, m, (height, width); 0 where it is not known."""
Size = Annotated[int, msgspec.Meta(ge=8, le=2048)]
Length = Annotated[float, msgspec.Meta(gt=0.0)]


class Intrinsics(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Pinhole model of a depth camera, without distortion. x points right in the image, y down, z along the axis.

    Attributes:
        width: Width of the image, pixels.
        height: Height of the image, pixels.
        fx: Focal length along x, pixels.
        fy: Focal length along y, pixels.
        cx: x coordinate of the principal point, pixels.
        cy: y coordinate of the principal point, pixels.
    """

    width: Size
    height: Size
    fx: Length
    fy: Length
    cx: float
    cy: float

    def rays(self) -> Floats:
        """Return the points at depth 1 of all pixels in the camera frame, (height, width, 3)."""
        x = (np.arange(self.width) - self.cx) / self.fx
        y = (np.arange(self.height) - self.cy) / self.fy
        across, down = np.meshgrid(x, y)
        return np.stack((across, down, np.ones_like(across)), axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrame:
    """One depth image.

    Attributes:
        number: Number that grows with each image; a number that stays is a camera that has stopped.
        captured: Time of the exposure, s of this machine's monotonic clock.
        depth: Depth along the optical axis, m, (height, width); 0 where it is not known.
    """

    number: int
    captured: float
    depth: Image


class DepthCamera(Protocol):
    """A depth camera.

    Attributes:
        intrinsics: Pinhole model of the camera.
    """

    intrinsics: Intrinsics

    def frames(self) -> AsyncIterator[DepthFrame]:
        """Yield each new image; end if there are no more."""

    def close(self) -> None:
        """Release the camera."""


def points_of(depth: Image, rays: Floats, chosen: npt.NDArray[np.bool_], base_from_camera: Transform) -> Floats:
    """Return the points of chosen pixels in the robot's base, m, (n, 3).

    Args:
        depth: Depth image, m, (height, width).
        rays: See `Intrinsics.rays`.
        chosen: Pixels whose depth is known, (height, width).
        base_from_camera: Pose of the camera in the robot's base.
    """
    in_camera = rays[chosen] * depth[chosen][:, None]
    return np.asarray(in_camera @ base_from_camera.rotation.T + base_from_camera.translation)
