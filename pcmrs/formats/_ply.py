"""Triangle meshes in binary PLY files, as `pcmrs skin` and most programs write them.

G. Turk, The PLY Polygon File Format, 1994. Only the usual form is read here. `pcmrs.formats.mesh` gives all others to
trimesh, which takes longer to load than the rest of a daemon.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

LONGEST_HEADER: Final = 65536
END: Final = b"end_header\n"
ORDERS: Final = {"binary_little_endian": "<", "binary_big_endian": ">"}
TYPES: Final = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def read_triangles(raw: bytes) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]] | None:
    """Return corners (V, 3) and indices (F, 3) of a file; None if it has another form than the usual one.

    The usual form is binary, has corners with scalar properties, among them x, y and z, and faces that are nothing but
    triangles.

    Args:
        raw: The whole file.
    """
    head, end, _ = raw[:LONGEST_HEADER].partition(END)
    if not end:
        return None
    types = _types(head)
    if types is None:
        return None
    (corners, corner), (triangles, triangle) = types
    begin = len(head) + len(end)
    middle = begin + corners * corner.itemsize
    if middle + triangles * triangle.itemsize != len(raw):
        return None
    found = np.frombuffer(raw, corner, corners, begin)
    faces = np.frombuffer(raw, triangle, triangles, middle)
    if not (faces["count"] == 3).all():
        return None
    return np.stack([found[axis].astype(float) for axis in "xyz"], axis=1), faces["corners"].astype(np.int64)


def _types(head: bytes) -> tuple[tuple[int, np.dtype[np.void]], tuple[int, np.dtype[np.void]]] | None:
    """How many corners and faces a header announces, and the layout of one of each; None for an unusual one."""
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    lines = [words for words in lines if words and words[0] not in ("comment", "obj_info")]
    match lines:
        case [["ply"], ["format", order, "1.0"], ["element", "vertex", corners], *properties, element, last]:
            pass
        case _:
            return None
    match element, last:
        case ["element", "face", faces], ["property", "list", count, index, "vertex_indices" | "vertex_index"]:
            pass
        case _:
            return None
    names = [words[-1] for words in properties]
    usual = all(len(words) == 3 and words[0] == "property" and words[1] in TYPES for words in properties)
    whole = corners.isdecimal() and faces.isdecimal() and TYPES.get(count, "f")[0] in "iu" and index in ("int", "uint")
    if not (order in ORDERS and usual and whole and {"x", "y", "z"} <= set(names) and len(names) == len(set(names))):
        return None
    sign = ORDERS[order]
    corner = np.dtype([(name, sign + TYPES[words[1]]) for name, words in zip(names, properties, strict=True)])
    face = np.dtype([("count", sign + TYPES[count]), ("corners", sign + TYPES[index], 3)])
    return (int(corners), corner), (int(faces), face)
