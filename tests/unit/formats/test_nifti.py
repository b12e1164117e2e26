"""NIfTI volumes are judged by their headers."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.volume import read_volume
from tests.unit.formats.phantom_volumes import nibabel


def bomb(path: Path, dim: tuple[int, ...], **more: Any) -> Path:
    """A small file whose header promises much."""
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.float64)
    header["dim"][: len(dim)] = dim
    header["pixdim"][1:4] = 1.0
    for name, value in {"sform_code": 1, "vox_offset": 352, **more}.items():
        header[name] = value
    raw = header.binaryblock + b"\1\0\0\0" + b"\0" * 1000
    path.write_bytes(gzip.compress(raw) if path.suffix == ".gz" else raw)
    return path


@pytest.mark.parametrize(
    ("dim", "more", "reason"),
    [
        ((3, 1024, 1024, 256), {}, "268 million; the limit is 200 million"),
        ((3, 32767, 32767, 32767), {}, "the limit is 200 million"),
        ((4, 20, 20, 20, 300), {}, "give one volume"),
        ((3, 20, 20, 1), {}, "at least two slices"),
        ((3, 20, 20, 20), {"vox_offset": 2e9}, "data at byte"),
        ((3, 20, 20, 20), {"sform_code": 0}, "has no position"),
        ((3, 20, 20, 20), {"datatype": 128, "bitpix": 24}, "instead of grey values"),
        ((3, 20, 20, 20), {}, "not a whole NIfTI"),
    ],
)
@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_a_volume_is_judged_by_its_header(name: str, dim: Any, more: Any, reason: str, tmp_path: Path) -> None:
    path = bomb(tmp_path / name, dim, **more)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_volume(path)
    assert str(path) in caught.value.text
