"""One DICOM series of slices, one file each: DICOM PS3.3 C.7.6.2 (LPS, mm)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.errors import InvalidDicomError
from pydicom.filereader import read_file_meta_info
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian, ImplicitVRLittleEndian

from pcmrs.formats.grid import Volume, as_ras, check_grid, check_size
from pcmrs.formats.reading import refuse
from pcmrs.spatial import Floats

MAX_FILES = 2000
MAX_FILE_BYTES = 16 * 1024 * 1024
"""Limit of a slice; one of 2048 x 2048 has 8 MB."""
PLAIN = (ImplicitVRLittleEndian, ExplicitVRLittleEndian, ExplicitVRBigEndian)
NEEDED = ("SeriesInstanceUID", "Rows", "Columns", "PixelSpacing", "ImageOrientationPatient", "ImagePositionPatient")
UNEVEN = 1e-4
"""Largest deviation of a slice from equal distances, m; rounded positions deviate."""
AIR = -1024.0
"""Lowest measured value, in Hounsfield units; scanners write lower values outside of their circle."""


def read_dicom(folder: Path) -> Volume:
    """Return the volume of the DICOM files in a folder; other files in it are ignored.

    Raises:
        FileFormatError: They are not a single, whole series of parallel slices at equal distances, or too large.
    """
    slices = [_slice(file) for file in _files(folder)]
    first = slices[0]
    series = {each.SeriesInstanceUID for each in slices}
    if len(series) > 1:
        refuse(folder, f"holds {len(series)} series; give the files of one.", series=len(series))
    for each in slices:
        same = (each.Rows, each.Columns) == (first.Rows, first.Columns)
        if not same or not np.allclose(_in_plane(each), _in_plane(first), atol=1e-4):
            refuse(Path(each.filename), "has another size or orientation than the other slices; give one series.")
    check_size(folder, (first.Columns, first.Rows, len(slices)))
    slices.sort(key=lambda each: float(np.cross(*_axes(first)) @ _position(each)))
    image_from_voxel = _grid(folder, slices)
    check_grid(folder, image_from_voxel)
    values = np.stack([_values(each) for each in slices], axis=2)
    if first.get("Modality") == "CT":
        np.maximum(values, AIR, out=values)
    return Volume(values, image_from_voxel)


def _files(folder: Path) -> list[Path]:
    found = sorted(file for file in folder.iterdir() if file.is_file() and _is_dicom(file))
    if not found:
        refuse(folder, "holds no DICOM files.")
    if len(found) > MAX_FILES:
        refuse(folder, f"holds {len(found)} DICOM files; the limit is {MAX_FILES}. Give one series.", limit=MAX_FILES)
    return found


def _is_dicom(file: Path) -> bool:
    with file.open("rb") as stream:
        return stream.read(132)[128:] == b"DICM" and file.name.upper() != "DICOMDIR"


def _slice(file: Path) -> Any:
    """Return the header of a slice, with its pixels as they are stored, still packed."""
    size = file.stat().st_size
    if size > MAX_FILE_BYTES:
        refuse(
            file, f"has {size / 1e6:.0f} MB; a slice has at most {MAX_FILE_BYTES / 1e6:.0f} MB.", limit=MAX_FILE_BYTES
        )
    try:
        syntax = read_file_meta_info(file).get("TransferSyntaxUID")
        if syntax not in PLAIN:
            name = getattr(syntax, "name", syntax)
            refuse(file, f"is compressed ({name}); unpack the series first, as with gdcmconv --raw.")
        found = pydicom.dcmread(file)
        missing = [name for name in NEEDED if found.get(name) is None]
        numbers = missing or (*map(float, _in_plane(found)), *_position(found))
    except (InvalidDicomError, OSError, EOFError, ValueError, TypeError, AttributeError, KeyError) as error:
        refuse(file, f"is not a whole DICOM image: {error}.")
    if missing:
        refuse(file, f"has no {', '.join(missing)}: it is not a slice of a volume, or several in one; export it again.")
    if not np.isfinite(np.array(numbers)).all() or found.get("SamplesPerPixel", 1) != 1:
        refuse(file, "holds colours, or a position that is not a number; give a series of grey slices.")
    return found


def _axes(each: Any) -> tuple[Floats, Floats]:
    """Return the unit vectors along a row and down a column, LPS."""
    directions = np.array(each.ImageOrientationPatient, dtype=float).reshape(2, 3)
    return directions[0], directions[1]


def _in_plane(each: Any) -> Floats:
    return np.array([*each.ImageOrientationPatient, *each.PixelSpacing], dtype=float)


def _position(each: Any) -> Floats:
    return np.array(each.ImagePositionPatient, dtype=float).reshape(3)


def _grid(folder: Path, slices: list[Any]) -> Floats:
    """Return ``image_from_voxel`` for indices along a row, down a column and through the slices.

    Slices may be evenly shifted against each other, as those of a tilted gantry are.
    """
    positions = as_ras([_position(each) for each in slices], "mm", "LPS")
    step = (positions[-1] - positions[0]) / (len(slices) - 1)
    along, down = as_ras(np.stack(_axes(slices[0])), "mm", "LPS")
    down_mm, along_mm = (float(value) for value in slices[0].PixelSpacing)
    uneven = np.linalg.norm(positions[0] + np.arange(len(slices))[:, None] * step - positions, axis=1)
    worst = int(uneven.argmax())
    if uneven[worst] > UNEVEN:
        text = f"has slices at unequal distances: number {worst + 1} is {uneven[worst] * 1e3:.2f} mm off; the limit is"
        refuse(folder, f"{text} {UNEVEN * 1e3:g} mm. One is missing or there twice: export the series again.")
    found = np.eye(4)
    found[:3] = np.column_stack((along * along_mm, down * down_mm, step, positions[0]))
    return found


def _values(each: Any) -> Any:
    """Return the grey values of a slice, (columns, rows)."""
    try:
        pixels = each.pixel_array.astype(np.float32)
        slope, intercept = float(each.get("RescaleSlope") or 1.0), float(each.get("RescaleIntercept") or 0.0)
    except (ValueError, AttributeError, TypeError, NotImplementedError, RuntimeError) as error:
        refuse(Path(each.filename), f"holds no pixels that can be read: {error}.")
    if pixels.shape != (each.Rows, each.Columns):
        refuse(Path(each.filename), "holds several slices in one file; export one file for each.")
    return (pixels * slope + intercept).T.astype(np.float32)
