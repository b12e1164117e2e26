"""An ellipsoid as a phantom, in volumes as scanners write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcmrs.formats.mesh import Mesh
from pcmrs.formats.skin import MOST_FACES
from pcmrs.spatial import Floats

nibabel = pytest.importorskip("nibabel")
pydicom = pytest.importorskip("pydicom")

SHAPE, EDGES = (48, 52, 40), np.array((0.004, 0.0035, 0.005))
CENTRE = np.array((0.013, -0.021, 0.034))
RADII = np.array((0.055, 0.06, 0.07))


def oblique(mirrored: bool = False) -> Floats:
    """A grid in no direction of the image, about `CENTRE`."""
    found = np.eye(4)
    axes = Rotation.from_rotvec((0.3, -0.4, 0.6)).as_matrix() * EDGES
    axes[:, 0] *= -1.0 if mirrored else 1.0
    found[:3, :3] = axes
    found[:3, 3] = CENTRE - axes @ ((np.array(SHAPE) - 1.0) / 2.0)
    return found


def phantom(grid: Floats) -> Any:
    """An ellipsoid, brightness by share of the voxel, with a dark shell in it and a speck beside it."""
    indices = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
    points = indices @ grid[:3, :3].T + grid[:3, 3] - CENTRE
    length = np.linalg.norm(points / RADII, axis=-1)
    away = (length - 1.0) * length / np.maximum(np.linalg.norm(points / RADII**2, axis=-1), 1e-9)
    values = 1000.0 * np.clip(0.5 - away / 0.004, 0.0, 1.0)
    values[(length > 0.6) & (length < 0.8)] = 0.0
    values[:3, :3, :3] = 1000.0
    return np.round(values + 100.0).astype(np.int16)


def write_nifti(path: Path, values: Any, grid: Floats, **header: Any) -> Path:
    image = nibabel.Nifti1Image(values, np.diag((1e3, 1e3, 1e3, 1.0)) @ grid)
    image.header.set_xyzt_units("mm")
    for name, value in header.items():
        image.header[name] = value
    nibabel.save(image, path)
    return path


def write_dicom(folder: Path, values: Any, grid: Floats) -> Path:
    """Slices in LPS and mm, numbered against their order in space."""
    folder.mkdir()
    lps = np.diag((-1e3, -1e3, 1e3, 1.0)) @ grid
    edges = np.linalg.norm(lps[:3, :3], axis=0)
    for number in range(values.shape[2]):
        dataset = pydicom.Dataset()
        dataset.file_meta = pydicom.dataset.FileMetaDataset()
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        dataset.SOPClassUID, dataset.SOPInstanceUID = "1.2.840.10008.5.1.4.1.1.4", f"1.2.3.{number}"
        dataset.SeriesInstanceUID, dataset.Modality = "1.2.3", "MR"
        dataset.Rows, dataset.Columns = values.shape[1], values.shape[0]
        dataset.PixelSpacing = [float(edges[1]), float(edges[0])]
        dataset.ImageOrientationPatient = (lps[:3, :2] / edges[:2]).T.round(9).ravel().tolist()
        dataset.ImagePositionPatient = (lps[:3, :3] @ (0, 0, number) + lps[:3, 3]).round(6).tolist()
        dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
        dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 16, 15, 1
        dataset.RescaleSlope, dataset.RescaleIntercept = 0.5, 100.0
        dataset.PixelData = (2 * (values[:, :, number].T - 100)).astype("<i2").tobytes()
        dataset.save_as(folder / f"{values.shape[2] - number:03d}.dcm", enforce_file_format=True)
    return folder


def check_is_phantom(mesh: Mesh) -> None:
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert len(mesh.faces) <= MOST_FACES
    assert solid.volume == pytest.approx(4.0 / 3.0 * np.pi * RADII.prod(), rel=0.04)  # positive: it faces outwards
    np.testing.assert_allclose(solid.center_mass, CENTRE, atol=EDGES.min() / 4.0)
    length = np.linalg.norm((mesh.vertices - CENTRE) / RADII, axis=1)
    assert np.abs(length - 1.0).max() * RADII.max() < EDGES.max() / 2.0
