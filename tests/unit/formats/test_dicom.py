"""Series of DICOM slices: one whole series, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.volume import read_volume
from tests.unit.formats.phantom_volumes import oblique, phantom, pydicom, write_dicom


def change(folder: Path, number: int, **fields: Any) -> None:
    path = sorted(folder.iterdir())[number]
    dataset = pydicom.dcmread(path)
    for name, value in fields.items():
        setattr(dataset, name, value)
    dataset.save_as(path)


def lose_one(folder: Path) -> None:
    sorted(folder.iterdir())[3].unlink()


def cut_one(folder: Path) -> None:
    path = sorted(folder.iterdir())[3]
    path.write_bytes(path.read_bytes()[:-500])


def compress_one(folder: Path) -> None:
    path = sorted(folder.iterdir())[3]
    dataset = pydicom.dcmread(path)
    dataset.compress(pydicom.uid.RLELossless)
    dataset.save_as(path)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lose_one, "unequal distances"),
        (cut_one, "no pixels that can be read|not a whole DICOM"),
        (compress_one, "is compressed"),
        (lambda folder: change(folder, 2, SeriesInstanceUID="1.2.4"), "holds 2 series"),
        (lambda folder: change(folder, 2, PixelSpacing=[1.0, 1.0]), "another size or orientation"),
        (lambda folder: change(folder, 2, Rows=30000, Columns=30000), "another size or orientation"),
        (lambda folder: change(folder, 2, ImagePositionPatient=None), "has no ImagePositionPatient"),
        (lambda folder: [path.unlink() for path in folder.iterdir()], "holds no DICOM files"),
    ],
)
def test_incomplete_series_is_refused(spoil: Any, reason: str, tmp_path: Path) -> None:
    folder = write_dicom(tmp_path / "series", phantom(oblique())[:, :, :6], oblique())
    spoil(folder)
    with pytest.raises(FileFormatError, match=reason):
        read_volume(folder)


def test_a_large_series_is_refused_by_its_headers(tmp_path: Path) -> None:
    folder = write_dicom(tmp_path / "series", phantom(oblique())[:, :, :2], oblique())
    for number in range(2):
        change(folder, number, Rows=30000, Columns=30000)
    with pytest.raises(FileFormatError, match="the limit is 200 million"):
        read_volume(folder)
