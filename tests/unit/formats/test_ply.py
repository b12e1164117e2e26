"""Binary PLY files of the usual form, compared with trimesh; all others are left to it."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.formats._ply import TYPES, read_triangles
from tests.support.trials import examples

NAMES = ("x", "y", "z", "nx", "red")
HEADER = (
    "ply\nformat {order} 1.0\ncomment x\nelement vertex {corners}\n{properties}element face {faces}\n{face}end_header\n"
)


def written(
    order: str, kinds: list[str], count: str, index: str, corners: np.ndarray, faces: np.ndarray, size: int = 3
) -> bytes:
    """A file with corners (V, 3) and faces (F, `size`); further properties of a corner are 0."""
    sign = "<" if order == "binary_little_endian" else ">"
    corner = np.zeros(len(corners), [(name, sign + TYPES[kind]) for name, kind in zip(NAMES, kinds, strict=False)])
    for axis, name in enumerate("xyz"):
        corner[name] = corners[:, axis]
    face = np.zeros(len(faces), [("count", sign + TYPES[count]), ("corners", sign + TYPES[index], size)])
    face["count"], face["corners"] = size, faces
    header = HEADER.format(
        order=order,
        corners=len(corners),
        faces=len(faces),
        properties="".join(f"property {kind} {name}\n" for name, kind in zip(NAMES, kinds, strict=False)),
        face=f"property list {count} {index} vertex_indices\n",
    )
    return header.encode() + corner.tobytes() + face.tobytes()


@given(
    order=st.sampled_from(["binary_little_endian", "binary_big_endian"]),
    axes=st.sampled_from(["float", "double", "float32"]),
    further=st.lists(st.sampled_from(["float", "uchar"]), max_size=2),
    count=st.sampled_from(["uchar", "int"]),
    index=st.sampled_from(["int", "uint"]),
    seed=st.integers(0, 1000),
)
@examples(60)
def test_the_usual_form_is_read_as_trimesh_reads_it(
    order: str, axes: str, further: list[str], count: str, index: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    corners, faces = rng.standard_normal((rng.integers(3, 20), 3)), rng.integers(0, 3, (rng.integers(0, 30), 3))
    raw = written(order, [axes] * 3 + further, count, index, corners, faces)
    found = read_triangles(raw)
    assert found is not None
    if len(faces):
        read = trimesh.load_mesh(io.BytesIO(raw), file_type="ply", process=False)
        np.testing.assert_array_equal(found[0], read.vertices)
        np.testing.assert_array_equal(found[1], read.faces)
    assert found[1].shape == faces.shape


SQUARE = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
USUAL = written("binary_little_endian", ["float"] * 3, "uchar", "int", SQUARE, np.array([(0, 1, 2), (0, 2, 3)]))


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        USUAL[:-1],
        USUAL + b"\0",
        USUAL.replace(b"vertex 4", b"vertex 9999999999999"),
        USUAL.replace(b"vertex 4", b"vertex -4"),
        USUAL.replace(b"face 2", b"face 1"),
        USUAL.replace(b"float x", b"float y"),
        USUAL.replace(b"float x", b"half x"),
        USUAL.replace(b"list uchar", b"list float"),
        USUAL.replace(b"vertex_indices", b"others"),
        USUAL.replace(b"binary_little_endian", b"ascii"),
        USUAL.replace(b"end_header\n", b"end_header\r"),
        written("binary_little_endian", ["float"] * 3, "uchar", "int", SQUARE, np.array([(0, 1, 2, 3)]), size=4),
    ],
)
def test_any_other_form_is_left_to_others(raw: bytes) -> None:
    assert read_triangles(raw) is None
