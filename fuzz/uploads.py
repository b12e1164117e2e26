"""Files that are uploaded or read by commands: a value of its kind, or refused with the file's name.

python -m fuzz.uploads -max_total_time=60
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import atheris
import numpy as np

from fuzz.running import run

with atheris.instrument_imports(include=["pcmrs.formats", "yaml"]):
    from pcmrs.errors import FileFormatError
    from pcmrs.formats.landmarks import read_landmarks
    from pcmrs.formats.mesh import read_mesh
    from pcmrs.formats.volume import read_volume

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz-uploads-"))
LANDMARKS = (".mrk.json", ".fcsv", ".yaml", ".csv", ".json")
MESHES = (".ply", ".stl", ".obj")
VOLUMES = (".nii", ".nii.gz", ".dcm")
ENDINGS = (*LANDMARKS, *MESHES, *VOLUMES)


def one(data: bytes) -> None:
    """The first byte chooses the ending."""
    ending = ENDINGS[data[0] % len(ENDINGS) if data else 0]
    path = FOLDER / f"file{ending}"
    path.write_bytes(data[1:])
    try:
        if ending in LANDMARKS:
            found = read_landmarks(path)
            assert len(found.names) == len(found.points) == len(set(found.names))
            assert np.isfinite(found.points).all()
        elif ending in MESHES:
            mesh = read_mesh(path, "mm", "RAS")
            assert mesh.faces.min() >= 0
            assert mesh.faces.max() < len(mesh.vertices)
            assert np.isfinite(mesh.vertices).all()
        else:
            read_volume(path)
    except FileFormatError as error:
        assert "file" in error.text  # noqa: PT017  # no test: libFuzzer finds what raises


if __name__ == "__main__":
    point = b'{"label": "n", "position": [0, 1, 2], "positionStatus": "defined"}'
    markups = b'{"markups": [{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [%s]}]}' % point
    corners = b"".join(b"property float %c\n" % axis for axis in b"xyz")
    ply = b"ply\nformat ascii 1.0\nelement vertex 3\n" + corners
    ply += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    loop = b"outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
    run(
        one,
        b"\x00" + markups,
        b"\x01# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n1,0,1,2,0,0,0,1,1,1,0,n,,\n",
        b"\x02PLANNED:\n  p0: {x: 0.1, y: 0.2, z: 0.3}\n",
        b"\x03name,x,y,z\nn,0.1,0.2,0.3\n",
        b"\x05" + ply,
        b"\x06solid a\nfacet normal 0 0 1\n" + loop + b"endfacet\nendsolid\n",
        b"\x07v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        b"\x08" + (348).to_bytes(4, "little") + bytes(340) + b"n+1\0",
        b"\x0a" + bytes(128) + b"DICM",
    )
