"""Depth images in a file: recorded once, and looked at as often as needed."""

from __future__ import annotations

import zipfile
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from pcmrs.clock import Clock
from pcmrs.errors import FileFormatError
from pcmrs.scene.depth_frame import DepthFrame, Intrinsics

MILLIMETRE = 1e-3
UNREADABLE = (OSError, EOFError, ValueError, KeyError, AttributeError, zipfile.BadZipFile, msgspec.MsgspecError)
"""Errors of NumPy and msgspec for a file that holds something else."""


def write_frames(path: Path, intrinsics: Intrinsics, frames: Sequence[DepthFrame]) -> None:
    """Write depth images as whole millimetres into a compressed NumPy archive.

    Args:
        path: File to write, ending in ``.npz``.
        intrinsics: Pinhole model of the camera.
        frames: The images, oldest first.
    """
    depths = np.array([np.round(frame.depth / MILLIMETRE) for frame in frames])
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            depth_mm=np.clip(depths, 0, np.iinfo(np.uint16).max).astype(np.uint16),
            captured=np.array([frame.captured for frame in frames]),
            intrinsics=np.frombuffer(msgspec.json.encode(intrinsics), dtype=np.uint8),
        )


class RecordedCamera:
    """`pcmrs.scene.depth_frame.DepthCamera` with the images of a file, at the pace of their recording.

    Args:
        path: File that `write_frames` has written.
        clock: Clock of the machine.

    Raises:
        FileFormatError: The file cannot be read, or holds no depth images.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                self._depths = archive["depth_mm"]
                self._captured = archive["captured"].astype(float).tolist()
                self.intrinsics = msgspec.json.decode(archive["intrinsics"].tobytes(), type=Intrinsics)
        except UNREADABLE as error:
            text = f"{path} holds no depth images: {error}. Record them with pcmrs scene --record FILE."
            raise FileFormatError(text, file=str(path)) from None
        expected = (len(self._captured), self.intrinsics.height, self.intrinsics.width)
        if self._depths.dtype != np.uint16 or self._depths.shape != expected or not self._captured:
            text = f"{path} holds depth images of shape {self._depths.shape}, not of {expected}."
            raise FileFormatError(text, file=str(path))
        self._clock = clock

    def close(self) -> None:
        """Do nothing: the images are in memory."""

    async def frames(self) -> AsyncIterator[DepthFrame]:
        """Yield the images with present times; end after the last."""
        start = self._clock.monotonic() - self._captured[0]
        for number, (captured, depth) in enumerate(zip(self._captured, self._depths, strict=True)):
            await self._clock.sleep(max(0.0, start + captured - self._clock.monotonic()))
            yield DepthFrame(number, start + captured, depth.astype(np.float32) * np.float32(MILLIMETRE))
