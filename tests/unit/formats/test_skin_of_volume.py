"""A phantom's surface comes back from volumes as scanners write them; what is none is refused by its header."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcmrs.errors import FileFormatError, GeometryError
from pcmrs.formats.grid import Volume
from pcmrs.formats.mesh import Mesh
from pcmrs.formats.skin import MOST_FACES, skin_of
from pcmrs.formats.volume import read_volume
from pcmrs.spatial import Floats

nibabel = pytest.importorskip("nibabel")
pydicom = pytest.importorskip("pydicom")
pytest.importorskip("skimage")

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


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_surface_is_where_the_phantom_is(mirrored: bool, tmp_path: Path) -> None:
    grid = oblique(mirrored)
    for name in ("head.nii", "head.nii.gz"):
        check_is_phantom(skin_of(read_volume(write_nifti(tmp_path / name, phantom(grid), grid))))


def test_nifti_and_dicom_of_one_phantom_give_one_surface(tmp_path: Path) -> None:
    grid = oblique()
    nifti = read_volume(write_nifti(tmp_path / "head.nii.gz", phantom(grid), grid))
    dicom = read_volume(write_dicom(tmp_path / "series", phantom(grid), grid))
    np.testing.assert_allclose(dicom.image_from_voxel, nifti.image_from_voxel, atol=1e-7)
    np.testing.assert_allclose(dicom.values, nifti.values)
    first, second = skin_of(nifti), skin_of(dicom)
    np.testing.assert_array_equal(first.faces, second.faces)
    np.testing.assert_allclose(first.vertices, second.vertices, atol=1e-7)


def test_a_fine_volume_is_averaged_and_stays_in_place() -> None:
    grid = np.diag((0.0007, 0.0007, 0.0009, 1.0))
    points = np.stack(np.meshgrid(*map(np.arange, (120, 120, 100)), indexing="ij"), axis=-1) * np.diag(grid)[:3]
    middle, radius = np.array((0.042, 0.04, 0.045)), 0.03
    values = np.clip(0.5 - (np.linalg.norm(points - middle, axis=-1) - radius) / 0.0007, 0.0, 1.0)
    mesh = skin_of(Volume(values.astype(np.float32), grid), threshold=0.5)
    lengths = np.linalg.norm(mesh.vertices - middle, axis=1)
    np.testing.assert_allclose(lengths, radius, atol=0.0003)


def test_skin_that_leaves_the_volume_is_closed_at_its_border() -> None:
    values = np.zeros((40, 40, 40), np.float32)
    values[10:30, 10:30, :25] = 1.0
    import trimesh

    mesh = skin_of(Volume(values, np.diag((0.002, 0.002, 0.002, 1.0))))
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight


@pytest.mark.parametrize(
    ("values", "threshold", "reason"),
    [
        (np.zeros((9, 9, 9)), None, "everywhere"),
        (np.eye(27).reshape(9, 9, 9), 0.99, "Only 0 connected"),
        (np.arange(20**3).reshape(20, 20, 20), -1.0, "Everything"),
    ],
)
def test_a_volume_without_a_surface_is_refused(values: Any, threshold: float | None, reason: str) -> None:
    with pytest.raises(GeometryError, match=reason):
        skin_of(Volume(values.astype(np.float32), np.diag((0.002, 0.002, 0.002, 1.0))), threshold)


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
