"""What one message of a PLUS server says of tracked tools."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcmrs.devices.plus.rigid import rigid
from pcmrs.errors import RefusalError
from pcmrs.spatial import Transform

Reading = Transform | str
"""``tracker_from_body``, or why there is none."""


def readings(message: Any) -> dict[str, Reading]:
    """Name of the transform to what a TRANSFORM or TDATA message says of it.

    PLUS tells the status of a tool in the metadata of a version 2 header: ``TransformStatus``, and in TDATA the name
    followed by ``Status``. Without metadata, an exact identity is the place holder of a tool that was never seen.
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
