"""Background of a fixed depth camera: the depth of each pixel in an empty scene, and how much of it is visible now."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.scene.depth_frame import Image

LEAST_FRAMES: Final = 5
LEAST_KNOWN: Final = 0.3
"""Least share of pixels with a known depth in an empty scene."""
OCCLUDED_SHARE: Final = 0.6
"""Share of the pixels before the background, or without depth, from which the camera counts as occluded."""
MOVED_SHARE: Final = 0.25
"""Share of the pixels behind the background from which the camera counts as moved: nothing in a scene is behind it."""
NOISE_OF_DEPTH: Final = 0.01
"""Part of the depth by which it may vary: the error of stereo cameras grows with it."""

Mask = npt.NDArray[np.bool_]


class Background:
    """Depth of an empty scene, as the median over some images, and its spread.

    What the arm hides in these images is not known yet: there, only what is nearer than the arm was is before the
    background, until `reveal` has seen what is behind it.

    Args:
        depths: Images of the empty scene, m, (n, height, width); 0 where the depth is not known, or shows the arm.
        hidden: Depth of the arm where it hides the scene, m, (height, width); 0 elsewhere.
        tolerance: Least distance of an object before the background, m.

    Raises:
        GeometryError: There are fewer than `LEAST_FRAMES` images, or too few pixels have a known depth.
    """

    def __init__(self, depths: npt.ArrayLike, hidden: Image, tolerance: float) -> None:
        images = np.asarray(depths, dtype=np.float32)
        if images.ndim != 3 or len(images) < LEAST_FRAMES:
            text = f"A background needs at least {LEAST_FRAMES} depth images of one size, not {images.shape}."
            raise GeometryError(text, images=len(images))
        known = images > 0.0
        often = known.mean(axis=0) > 0.5
        self._waiting = ~often & (hidden > 0.0)
        known_share = float((often | self._waiting).mean())
        if known_share < LEAST_KNOWN:
            text = f"Only {known_share:.0%} of the pixels have a depth: at least {LEAST_KNOWN:.0%} are needed. "
            raise GeometryError(f"{text}Look at the camera, its range and its light.", known=known_share)
        self._depth = np.where(often, _median(images, known), np.where(self._waiting, hidden, 0.0)).astype(np.float32)
        spread = _median(np.abs(images - self._depth), known)
        self._near = np.maximum(tolerance, np.maximum(5.0 * spread, NOISE_OF_DEPTH * self._depth)).astype(np.float32)
        self._tolerance = tolerance
        self._known = often | self._waiting

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the images, pixels."""
        height, width = self._depth.shape
        return int(height), int(width)

    def before(self, depth: Image) -> Mask:
        """Return the pixels that are nearer than the background, or near where the background has no depth.

        Args:
            depth: Depth image, m, (height, width).
        """
        seen = depth > 0.0
        return np.asarray(seen & (~self._known | (depth < self._depth - self._near)))

    def hidden_before(self, depth: Image) -> Mask:
        """Return the pixels that the arm has hidden until now, and that show something.

        Args:
            depth: Depth image, m, (height, width).
        """
        return np.asarray(self._waiting & (depth > 0.0))

    def reveal(self, depth: Image, chosen: Mask) -> None:
        """Take pixels that the arm has hidden until now as background.

        Args:
            depth: Depth image of an empty scene, m, (height, width).
            chosen: Those pixels of `hidden_before` that do not show the arm.
        """
        self._depth[chosen] = depth[chosen]
        self._near[chosen] = np.maximum(self._tolerance, NOISE_OF_DEPTH * depth[chosen])
        self._waiting &= ~chosen

    def trouble(self, depth: Image, explained: Mask) -> str:
        """Return why the scene cannot be seen: ``occluded`` or ``camera_moved``; empty if it can.

        Args:
            depth: Depth image, m, (height, width).
            explained: Pixels that show the arm or the body, (height, width).
        """
        known = self._known & ~self._waiting & ~explained
        total = max(1, int(known.sum()))
        behind = known & (depth > self._depth + self._near)
        if behind.sum() > MOVED_SHARE * total:
            return "camera_moved"
        hidden = known & ((depth <= 0.0) | self.before(depth))
        return "occluded" if hidden.sum() > OCCLUDED_SHARE * total else ""


def _median(values: npt.NDArray[np.float32], known: Mask) -> npt.NDArray[np.float32]:
    """Return the lower median over the first axis of the known values; 0 where none is known."""
    ordered = np.sort(np.where(known, values, np.inf), axis=0)
    middle = np.maximum(0, (known.sum(axis=0) - 1) // 2)
    found = np.take_along_axis(ordered, middle[None], axis=0)[0]
    return np.where(np.isfinite(found), found, 0.0).astype(np.float32)
