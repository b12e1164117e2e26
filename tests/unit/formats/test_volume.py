"""Volumes by their kind: NIfTI and DICOM of one phantom agree, any other file is refused."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.skin import skin_of
from pcmrs.formats.volume import read_volume
from tests.unit.formats.phantom_volumes import oblique, phantom, write_dicom, write_nifti

pytest.importorskip("skimage")


def test_nifti_and_dicom_of_one_phantom_give_one_surface(tmp_path: Path) -> None:
    grid = oblique()
    nifti = read_volume(write_nifti(tmp_path / "head.nii.gz", phantom(grid), grid))
    dicom = read_volume(write_dicom(tmp_path / "series", phantom(grid), grid))
    np.testing.assert_allclose(dicom.image_from_voxel, nifti.image_from_voxel, atol=1e-7)
    np.testing.assert_allclose(dicom.values, nifti.values)
    first, second = skin_of(nifti), skin_of(dicom)
    np.testing.assert_array_equal(first.faces, second.faces)
    np.testing.assert_allclose(first.vertices, second.vertices, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "raw", "reason"),
    [
        ("a.vtk", b"", "not a volume that can be read"),
        ("a.nii", b"nonsense", "does not begin with a header"),
        ("a.nii.gz", b"nonsense", "not a whole NIfTI"),
        ("a.nii.gz", gzip.compress(bytes(2000), mtime=0)[:20], "not a whole NIfTI|does not begin"),
    ],
)
def test_invalid_volume_is_refused(name: str, raw: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(FileFormatError, match=reason):
        read_volume(tmp_path / name)
