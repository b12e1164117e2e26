"""Pictures and films as PNG files: one frame, or an animation that browsers play.

PNG (Third Edition), W3C 2025, which includes animations (APNG). The standard library compresses; no codec is needed.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
"""Red, green and blue of each pixel, (height, width, 3)."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EIGHT_BIT_RGB = (8, 2, 0, 0, 0)
_UP = 2
"""Filter that stores the difference from the row above: smooth surfaces then need less space."""
_PLAYED_ONCE = 1
_NO_OFFSET, _KEPT, _REPLACED = (0, 0), 0, 0


class PngFile:
    """Encoder of pictures, one by one, so that no film is held in memory.

    Args:
        count: Number of pictures; one gives an ordinary PNG.
        fps: Pictures per second of a film.
    """

    def __init__(self, count: int, fps: int) -> None:
        self._count, self._fps = count, fps
        self._taken = self._sequence = 0

    def add(self, picture: Picture) -> bytes:
        """Return the next part of the file.

        Args:
            picture: Next picture, of the size of the first.
        """
        height, width, _ = picture.shape
        first, animated = not self._taken, self._count > 1
        self._taken += 1
        part = b""
        if first:
            part += SIGNATURE + _chunk(b"IHDR", struct.pack(">II5B", width, height, *_EIGHT_BIT_RGB))
        if first and animated:
            part += _chunk(b"acTL", struct.pack(">II", self._count, _PLAYED_ONCE))
        if animated:
            times = (1, self._fps, _KEPT, _REPLACED)
            part += _chunk(b"fcTL", struct.pack(">5I2H2B", self._next(), width, height, *_NO_OFFSET, *times))
        if first:
            part += _chunk(b"IDAT", _compressed(picture))
        else:
            part += _chunk(b"fdAT", struct.pack(">I", self._next()) + _compressed(picture))
        return part + _chunk(b"IEND", b"") if self._taken == self._count else part

    def _next(self) -> int:
        """Return the next number of the sequence of animation chunks."""
        number = self._sequence
        self._sequence += 1
        return number


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def _compressed(picture: Picture) -> bytes:
    height, width, channels = picture.shape
    rows = picture.reshape(height, width * channels)
    filtered = np.full((height, 1 + width * channels), _UP, dtype=np.uint8)
    filtered[0, 1:] = rows[0]
    filtered[1:, 1:] = rows[1:] - rows[:-1]  # modulo 256, as the format says
    return zlib.compress(filtered.tobytes())
