"""Volumes of other software: NIfTI, plain and compressed, and DICOM are grids, or are refused by name.

python -m fuzz.volumes -max_total_time=60
"""

from __future__ import annotations

import numpy as np

from fuzz.running import UploadedFile, instrumented, run

with instrumented("pcmrs.formats"):
    from pcmrs.errors import FileFormatError
    from pcmrs.formats.volume import read_volume

FILE = UploadedFile("file.nii", "file.nii.gz", "file.dcm")


def one(data: bytes) -> None:
    """Read a volume; the first byte selects the extension."""
    try:
        volume = read_volume(FILE.write(data))
    except FileFormatError as error:
        assert "file" in error.text  # noqa: PT017  # not a test: libFuzzer finds inputs that raise
        return
    assert np.isfinite(volume.values).all()
    assert np.isfinite(volume.image_from_voxel).all()


if __name__ == "__main__":
    run(one)
