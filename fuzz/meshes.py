"""Surfaces of other software: PLY, STL and OBJ are meshes, or are refused by name.

python -m fuzz.meshes -max_total_time=60
"""

from __future__ import annotations

import numpy as np
import trimesh  # noqa: F401  # `read_mesh` loads it for some inputs, which then could be slower than is allowed

from fuzz.running import UploadedFile, instrumented, run

with instrumented("pcmrs.formats"):
    from pcmrs.errors import FileFormatError
    from pcmrs.formats.mesh import read_mesh

FILE = UploadedFile("file.ply", "file.stl", "file.obj")


def one(data: bytes) -> None:
    """Read a mesh; the first byte selects the extension."""
    try:
        mesh = read_mesh(FILE.write(data), "mm", "RAS")
    except FileFormatError as error:
        assert "file" in error.text  # noqa: PT017  # not a test: libFuzzer finds inputs that raise
        return
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    assert np.isfinite(mesh.vertices).all()


if __name__ == "__main__":
    run(one)
