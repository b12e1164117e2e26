"""Files that are uploaded or read by commands: each is a value of its kind, or is refused with the file's name.

python -m fuzz.uploads -max_total_time=60
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from fuzz.running import instrumented, run

with instrumented("pcmrs.formats", "yaml"):
    from pcmrs.errors import FileFormatError
    from pcmrs.formats.landmarks import read_landmarks
    from pcmrs.formats.mesh import read_mesh
    from pcmrs.formats.volume import read_volume

FOLDER = tempfile.TemporaryDirectory(prefix="fuzz-uploads-")
LANDMARKS = (".mrk.json", ".fcsv", ".yaml", ".csv", ".json")
MESHES = (".ply", ".stl", ".obj")
VOLUMES = (".nii", ".nii.gz", ".dcm")
ENDINGS = (*LANDMARKS, *MESHES, *VOLUMES)


def one(data: bytes) -> None:
    """Read a file; the first byte selects its extension."""
    ending = ENDINGS[data[0] % len(ENDINGS) if data else 0]
    path = Path(FOLDER.name, f"file{ending}")
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
        assert "file" in error.text  # noqa: PT017  # not a test: libFuzzer finds inputs that raise


if __name__ == "__main__":
    run(one)
