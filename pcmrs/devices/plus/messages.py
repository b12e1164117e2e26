"""OpenIGTLink messages: those of `pyigtl`, and STATUS, TDATA and STT_TDATA, which it lacks.

From the layouts of the OpenIGTLink protocol, versions 2 and 3 (``igtl_status.h``, ``igtl_tdata.h``). Only the messages
of `pyigtl` are used. Its connections (0.3.4) install their own handlers of SIGTERM and SIGINT, lose a header that
arrives in two segments, use a whole processor after the other side has left, and check no CRC.

Rigid transforms in OpenIGTLink are homogeneous matrices in mm, of single precision.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from pyigtl.messages import CRC64, MessageBase, PointMessage, StringMessage, TransformMessage

from pcmrs.errors import PayloadError, RefusalError
from pcmrs.spatial import Floats, Transform

TOLERANCE = 1e-4
"""Greatest deviation of R R^T from I: the error of single precision and a chain of products, 0.006 degrees."""


def rigid(matrix_mm: npt.ArrayLike) -> Transform:
    """Return the transform, in m, of a matrix (4, 4) in mm; its rotation is the orthonormal one nearest to the matrix.

    The nearest rotation is the polar factor (Higham, Computing the Polar Decomposition, 1986), by singular values.

    Raises:
        RefusalError: ``not_finite``, ``mirrored``, or ``not_rigid`` with the deviation from a rotation.
    """
    matrix = np.array(matrix_mm, dtype=float)
    if not np.isfinite(matrix).all():
        raise RefusalError("not_finite", "The transform holds a number that is not finite; send a rigid transform.")
    rotation = matrix[:3, :3]
    deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if deviation > TOLERANCE:
        text = f"R R^T differs from I by {deviation:.3g}, the limit is {TOLERANCE:g}: the transform scales or shears."
        raise RefusalError("not_rigid", f"{text} Send a rigid one.", deviation=deviation, limit=TOLERANCE)
    if np.linalg.det(rotation) < 0.0:
        raise RefusalError("mirrored", "The transform mirrors: its determinant is -1, a rotation's is +1.")
    left, _, right = np.linalg.svd(rotation)
    return Transform(left @ right, matrix[:3, 3] * 1e-3)


def matrix_mm(transform: Transform) -> Floats:
    """Return the homogeneous matrix of a transform, (4, 4), mm."""
    matrix = transform.matrix
    matrix[:3, 3] *= 1e3
    return matrix


POINT_BYTES = 136
"""Length of one point of a POINT message, bytes."""
MAX_TEXT = 65_535
"""Length of the longest STRING, bytes."""

STATUS_OK = 1
STATUS_ERROR = 2
STATUS_EMERGENCY = 3

_STATUS = struct.Struct(">Hq20s")
_ELEMENT = struct.Struct(">20sBB12f")
_SIX_DEGREES = 2  # an element's type: position and orientation


class StatusMessage(MessageBase):  # type: ignore[misc]  # pyigtl has no types
    """Status of the sender: a code (1 is ok), a short name and a sentence, in ASCII."""

    def __init__(self, code: int = STATUS_OK, error_name: str = "", text: str = "", **header: Any) -> None:
        super().__init__(**header)
        self._message_type = "STATUS"
        self._valid_message = True
        self.code, self.error_name, self.text = code, error_name, text

    def _pack_content(self) -> bytes:
        return _STATUS.pack(self.code, 0, as_ascii(self.error_name)[:20]) + as_ascii(self.text) + b"\0"

    def _unpack_content(self, content: bytes) -> None:
        self.code, _, name = _STATUS.unpack_from(content)
        self.error_name, self.text = _name(name), _name(content[_STATUS.size :])


class TrackingDataMessage(MessageBase):  # type: ignore[misc]
    """Poses of several tools at one time: homogeneous matrix (4, 4), mm, by name."""

    def __init__(self, matrices: Mapping[str, Any] | None = None, **header: Any) -> None:
        super().__init__(**header)
        self._message_type = "TDATA"
        self._valid_message = True
        self.matrices: dict[str, Any] = dict(matrices or {})

    def _pack_content(self) -> bytes:
        return b"".join(
            _ELEMENT.pack(as_ascii(name)[:20], _SIX_DEGREES, 0, *_columns(matrix))
            for name, matrix in self.matrices.items()
        )

    def _unpack_content(self, content: bytes) -> None:
        self.matrices = {
            _name(name): [[*row] for row in zip(n[0:3], n[3:6], n[6:9], n[9:12], strict=True)] + [[0.0, 0.0, 0.0, 1.0]]
            for name, _, _, *n in _ELEMENT.iter_unpack(content)
        }


class StartTrackingDataMessage(MessageBase):  # type: ignore[misc]
    """Request for TDATA at the server's full rate.

    Args:
        header_version: 2 makes PLUS send metadata, too. A server that knows only version 1 misreads its body.
        header: See `MessageBase`.
    """

    def __init__(self, header_version: int = 2, **header: Any) -> None:
        super().__init__(**header)
        self._message_type = "STT_TDATA"
        self._valid_message = True
        self.header_version = header_version

    def _pack_content(self) -> bytes:
        return struct.pack(">i32s", 0, b"")


class WholePointMessage(PointMessage):  # type: ignore[misc]
    """A POINT message whose body must hold whole points; `pyigtl` drops the rest silently."""

    def _unpack_content(self, content: bytes) -> None:
        if len(content) % POINT_BYTES:
            raise ValueError(f"{len(content)} bytes are no whole number of points of {POINT_BYTES} bytes")
        super()._unpack_content(content)


class WholeStringMessage(StringMessage):  # type: ignore[misc]
    """A STRING message whose length must be the one in its body."""

    def _unpack_content(self, content: bytes) -> None:
        super()._unpack_content(content)
        if len(content) != 4 + struct.unpack_from(">H", content, 2)[0]:
            raise ValueError("the text is not as long as it says")


_KINDS = {
    "TRANSFORM": TransformMessage,
    "POINT": WholePointMessage,
    "STRING": WholeStringMessage,
    "STATUS": StatusMessage,
    "TDATA": TrackingDataMessage,
}


def unpack(header: Mapping[str, Any], crc: int, body: bytes) -> Any:
    """Decode a message as a `pyigtl` message.

    Args:
        header: Parsed header of `pyigtl`.
        crc: CRC in the header.
        body: Body of the message.

    Raises:
        PayloadError: The CRC is wrong, or the body does not fit the type of the message.
    """
    kind = header["message_type"]
    if CRC64(body) != crc:
        raise PayloadError(f"The CRC of a {kind} message does not fit its body; it was damaged on the way.", kind=kind)
    message = _KINDS[kind]()
    try:
        message.unpack(header, body)
    except (struct.error, ValueError, IndexError, TypeError) as error:
        raise PayloadError(f"The body of a {kind} message cannot be read: {error}.", kind=kind) from None
    return message


def as_ascii(text: str) -> bytes:
    """Return `text` in ASCII for a short field: `pyigtl` fails on other letters, and stock receivers show none."""
    return text.encode("ascii", "replace")


def text_message(text: str, **header: Any) -> Any:
    """Return a STRING message in ASCII, cut to the longest possible text."""
    return StringMessage(as_ascii(text)[:MAX_TEXT].decode(), **header)


def _columns(matrix: Any) -> list[float]:
    """Return the upper three rows of a matrix, column by column, in the order of the protocol."""
    return [float(matrix[row][column]) for column in range(4) for row in range(3)]


def _name(field: bytes) -> str:
    return field.split(b"\0")[0].decode("ascii").strip()


Reading = Transform | str
"""``tracker_from_body``, or the reason why there is none."""


def readings(message: Any) -> dict[str, Reading]:
    """Return the readings in a TRANSFORM or TDATA message by the name of the transform.

    PLUS reports the status of a tool in the metadata of a version 2 header: ``TransformStatus``, or in TDATA the name
    followed by ``Status``. Without metadata, an exact identity is the placeholder of a tool that was never seen.
    """
    if message.message_type == "TRANSFORM":
        status = message.metadata.get("TransformStatus", "OK")
        return {message.device_name: _reading(message.matrix, status)}
    metadata: Mapping[str, str] = message.metadata
    return {name: _reading(matrix, metadata.get(f"{name}Status", "OK")) for name, matrix in message.matrices.items()}


def _reading(matrix: Any, status: str) -> Reading:
    if status != "OK":
        return status.lower().removeprefix("tool_")
    if np.array_equal(matrix, np.eye(4)):
        return "identity"
    try:
        return rigid(matrix)
    except RefusalError as refusal:
        return refusal.refusal_code
