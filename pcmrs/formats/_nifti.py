"""NIfTI volumes in one file, compressed or not: https://nifti.nimh.nih.gov/nifti-1 (RAS, mm)."""

from __future__ import annotations

import gzip
import zlib
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import nibabel
import numpy as np

from pcmrs.formats.grid import METRES, Volume, check_grid, check_size
from pcmrs.formats.reading import refuse

LARGEST_HEADER = 16 * 1024 * 1024
"""Limit of the header and the extensions before the data, bytes."""
UNITS = {"mm": "mm", "meter": "m", "micron": "um", "unknown": "mm"}


def read_nifti(path: Path) -> Volume:
    """Return the volume of a ``.nii`` or ``.nii.gz`` file. The header is checked before anything else is read.

    Raises:
        FileFormatError: It is not NIfTI, too large, has no position in the scanner, or ends early.
    """
    try:
        unit = _check_header(path, _header(path))
        image: Any = nibabel.load(path)
        values = np.asarray(image.dataobj, dtype=np.float32).reshape(image.shape[:3])
    except (OSError, EOFError, zlib.error, ValueError, nibabel.filebasedimages.ImageFileError) as error:
        refuse(path, f"is not a whole NIfTI volume: {error}.")
    scale = np.diag([METRES[unit]] * 3 + [1.0])
    found = Volume(
        np.nan_to_num(values, nan=_least(values), posinf=_least(values), neginf=_least(values)), scale @ image.affine
    )
    check_grid(path, found.image_from_voxel)
    return found


def _header(path: Path) -> Any:
    """Return the header alone: the library's own reader would also read extensions of any length."""
    kinds: tuple[Any, ...] = (nibabel.Nifti1Header, nibabel.Nifti2Header)
    with path.open("rb") as stored, ExitStack() as stack:
        packed = path.name.lower().endswith(".gz")
        stream = stack.enter_context(gzip.GzipFile(fileobj=stored)) if packed else stored
        raw = stream.read(nibabel.Nifti2Header.sizeof_hdr)
    kind = next((kind for kind in kinds if kind.may_contain_header(raw)), None)
    if kind is None or len(raw) < kind.sizeof_hdr:
        refuse(path, "is not a NIfTI volume: it does not begin with a header.")
    return kind(raw[: kind.sizeof_hdr], check=False)


def _check_header(path: Path, header: Any) -> str:
    """Refuse a volume by its header; return the unit of its lengths."""
    shape = tuple(int(length) for length in header.get_data_shape())
    check_size(path, shape[:3] if all(length == 1 for length in shape[3:]) else shape)
    if header.get_data_dtype().kind not in "iuf":
        refuse(
            path, f"holds {header.get_data_dtype()} instead of grey values; convert it to one number for each voxel."
        )
    if not 0 <= header["vox_offset"] <= LARGEST_HEADER:
        refuse(path, f"has its data at byte {header['vox_offset']:g}; the limit is {LARGEST_HEADER}.")
    if not (header["qform_code"] > 0 or header["sform_code"] > 0):
        refuse(path, "has no position (qform and sform code 0), so that left and right are unknown; convert it again.")
    unit, _ = header.get_xyzt_units()
    return UNITS[unit]


def _least(values: Any) -> float:
    """Return the smallest finite value: values that are not numbers were outside of the image."""
    finite = values[np.isfinite(values)]
    return float(finite.min()) if finite.size else 0.0
