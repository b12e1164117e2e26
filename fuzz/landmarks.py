"""Landmarks of other software: markups of 3D Slicer, YAML of the laboratory, CSV, and plans; read, or refused by name.

python -m fuzz.landmarks -max_total_time=60
"""

from __future__ import annotations

import numpy as np

from fuzz.running import UploadedFile, instrumented, run

with instrumented("pcmrs.formats", "yaml"):
    from pcmrs.errors import FileFormatError
    from pcmrs.formats.landmarks import read_landmarks

FILE = UploadedFile("file.mrk.json", "file.fcsv", "file.yaml", "file.csv", "file.json")


def one(data: bytes) -> None:
    """Read landmarks; the first byte selects the extension."""
    try:
        found = read_landmarks(FILE.write(data))
    except FileFormatError as error:
        assert "file" in error.text  # noqa: PT017  # not a test: libFuzzer finds inputs that raise
        return
    assert len(found.names) == len(found.points) == len(set(found.names))
    assert np.isfinite(found.points).all()


if __name__ == "__main__":
    run(one)
