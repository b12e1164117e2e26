"""Reads volumes: NIfTI files, and folders with one DICOM series."""

from __future__ import annotations

from pathlib import Path

from pcmrs.errors import ConfigurationError
from pcmrs.formats.grid import Volume
from pcmrs.formats.reading import refuse

__all__ = ["read_volume"]

NIFTI = (".nii", ".nii.gz")


def read_volume(path: Path) -> Volume:
    """Return the volume of a NIfTI file, or of a folder with the files of one DICOM series.

    Raises:
        FileFormatError: It cannot be read, is too large, has no position, or is another kind of file.
        ConfigurationError: The library for it is not installed.
    """
    try:
        if path.is_dir():
            from pcmrs.formats._dicom import read_dicom

            return read_dicom(path)
        if path.name.lower().endswith(NIFTI):
            from pcmrs.formats._nifti import read_nifti

            return read_nifti(path)
    except ModuleNotFoundError as error:
        text = f"Volumes are read by the package {error.name}, which is missing: "
        text += "install the extra imaging (docs/supply.md)."
        raise ConfigurationError(text, package=error.name) from None
    refuse(path, f"is not a volume that can be read: give {' or '.join(NIFTI)}, or a folder with one DICOM series.")
