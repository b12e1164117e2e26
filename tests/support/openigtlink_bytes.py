"""OpenIGTLink messages written byte by byte from the protocol's pages, without any library: the tests' oracle."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

HEADER = struct.Struct(">H12s20sIIQQ")
STAMP = 1_700_000_000.25


def crc64(data: bytes) -> int:
    """CRC-64 of ECMA-182, bit by bit."""
    crc = 0
    for byte in data:
        crc ^= byte << 56
        for _ in range(8):
            crc = ((crc << 1) ^ (0x42F0E1EBA9EA3693 if crc >> 63 else 0)) & 0xFFFF_FFFF_FFFF_FFFF
    return crc


def message(kind: str, name: str, content: bytes, stamp: float = STAMP, version: int = 1) -> bytes:
    """Header and body; the fraction of a second is in units of 2^-32 s."""
    head = (kind.encode(), name.encode(), int(stamp), int((stamp - int(stamp)) * 2**32))
    return HEADER.pack(version, *head, len(content), crc64(content)) + content


def with_metadata(kind: str, name: str, content: bytes, metadata: Mapping[str, str], stamp: float = STAMP) -> bytes:
    """A message with a version 2 header: extended header, content, metadata index, metadata."""
    index = struct.pack(">H", len(metadata))
    for key, value in metadata.items():
        index += struct.pack(">HHI", len(key), 3, len(value))
    data = "".join(key + value for key, value in metadata.items()).encode()
    body = struct.pack(">HHII", 12, len(index), len(data), 0) + content + index + data
    return message(kind, name, body, stamp, version=2)


def matrix_bytes(matrix: npt.ArrayLike) -> bytes:
    """The upper three rows column by column, in single precision."""
    return np.asarray(matrix, dtype=">f4")[:3].T.tobytes()


def transform(name: str, matrix_mm: npt.ArrayLike, stamp: float = STAMP) -> bytes:
    return message("TRANSFORM", name, matrix_bytes(matrix_mm), stamp)


def string(name: str, text: str) -> bytes:
    return message("STRING", name, struct.pack(">HH", 3, len(text)) + text.encode())


def points(name: str, positions_mm: Sequence[Sequence[float]], names: Sequence[str]) -> bytes:
    content = b"".join(
        struct.pack(">64s32s4B3ff20s", label.encode(), b"", 255, 0, 0, 255, *position, 0.0, b"")
        for label, position in zip(names, positions_mm, strict=True)
    )
    return message("POINT", name, content)


def status(name: str, code: int, error_name: str, text: str) -> bytes:
    content = struct.pack(">Hq20s", code, 0, error_name.encode()) + text.encode() + b"\0"
    return message("STATUS", name, content)


def tracking_data(name: str, matrices_mm: Mapping[str, npt.ArrayLike]) -> bytes:
    return b"".join(
        struct.pack(">20sBB", tool.encode(), 2, 0) + matrix_bytes(matrix) for tool, matrix in matrices_mm.items()
    )
