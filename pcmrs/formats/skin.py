"""The outer surface of a body in a volume: the surface where the grey value crosses a threshold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from pcmrs.errors import ConfigurationError, GeometryError
from pcmrs.formats.grid import Volume
from pcmrs.formats.mesh import Mesh

__all__ = ["skin_of"]

FINEST = 0.0015
"""Finer voxels than this are averaged before the surface is extracted, m."""
SMOOTHING = 0.7
"""Deviation of the Gaussian against noise, in averaged voxels. It moves a surface of curvature radius R inwards
by (deviation squared) / R: 0.01 mm on a head."""
MOST_FACES = 60_000
LEAST_BODY = 1000
"""Fewest voxels of the largest connected part; a smaller part is not a body."""
STAGES = ("average", "separate", "surface", "simplify")

Step = Callable[[str, int, int], None]


def skin_of(volume: Volume, threshold: float | None = None, step: Step | None = None) -> Mesh:
    """Return the closed outer surface of the largest connected part that is brighter than a threshold.

    Holes are filled slice by slice along all three axes, so that skull and airways leave no inner surfaces; where the
    body leaves the volume it is cut off flat. The surface is found by marching cubes (Lewiner et al., J. Graph. Tools 8
    (2003) 1) in the grey values, so it lies between voxels, and is simplified by quadrics (Garland and Heckbert,
    SIGGRAPH 1997).

    Args:
        volume: Volume of a body that is brighter than its surroundings.
        threshold: Grey value of the surface; None for Otsu's (IEEE Trans. SMC 9 (1979) 62).
        step: Called with the present stage, the number of finished stages, and the number of stages.

    Raises:
        GeometryError: Nothing is brighter than the threshold, or too little, or all is.
        ConfigurationError: scikit-image is not installed.
    """
    try:
        from scipy import ndimage
        from skimage.filters import threshold_otsu
        from skimage.measure import marching_cubes
    except ModuleNotFoundError as error:
        text = f"The skin is extracted by the package {error.name}, which is missing: "
        text += "install the extra imaging (docs/supply.md)."
        raise ConfigurationError(text, package=error.name) from None
    say = step or (lambda _text, _done, _total: None)
    say(STAGES[0], 0, len(STAGES))
    values, image_from_voxel = _averaged(volume)
    values = ndimage.gaussian_filter(values, SMOOTHING)
    if values.min() == values.max():
        raise GeometryError(f"The volume is {values.min():g} everywhere; there is no surface in it.")
    level = float(threshold_otsu(values)) if threshold is None else threshold
    say(STAGES[1], 1, len(STAGES))
    body = _body(values, level)
    say(STAGES[2], 2, len(STAGES))
    vertices, faces, _, _ = marching_cubes(_only_body(values, body, level), level, allow_degenerate=False)
    say(STAGES[3], 3, len(STAGES))
    points = (vertices - 1.0) @ image_from_voxel[:3, :3].T + image_from_voxel[:3, 3]
    return _simplified(points, faces)


def _averaged(volume: Volume) -> tuple[npt.NDArray[np.float32], Any]:
    """Return blocks of voxels averaged to `FINEST`, and the positions of their centres."""
    edges = np.linalg.norm(volume.image_from_voxel[:3, :3], axis=0)
    factors = [
        max(1, min(round(FINEST / edge), length // 2)) for edge, length in zip(edges, volume.values.shape, strict=True)
    ]
    counts = [length // factor for length, factor in zip(volume.values.shape, factors, strict=True)]
    cut = volume.values[tuple(slice(0, count * factor) for count, factor in zip(counts, factors, strict=True))]
    blocks = cut.reshape([each for pair in zip(counts, factors, strict=True) for each in pair])
    averaged = blocks.mean(axis=(1, 3, 5), dtype=np.float32)
    voxel_from_block = np.diag([*map(float, factors), 1.0])
    voxel_from_block[:3, 3] = (np.array(factors) - 1.0) / 2.0
    return averaged, volume.image_from_voxel @ voxel_from_block


def _body(values: npt.NDArray[np.float32], level: float) -> npt.NDArray[np.bool_]:
    """Return the voxels of the largest part, with holes filled first: a dark skull may separate scalp and brain."""
    from scipy import ndimage

    bright = values > level
    for axis in range(3):
        for section in np.moveaxis(bright, axis, 0):
            section |= ndimage.binary_fill_holes(section)
    parts, _ = ndimage.label(bright)
    sizes = np.bincount(parts.ravel(), minlength=2)
    sizes[0] = 0
    largest = int(sizes.argmax())
    if sizes[largest] < LEAST_BODY:
        text = (
            f"Only {sizes[largest]} connected voxels are brighter than {level:g}; the values go from {values.min():g}"
        )
        raise GeometryError(
            f"{text} to {values.max():g}. Give another threshold.", level=level, voxels=int(sizes[largest])
        )
    body: npt.NDArray[np.bool_] = parts == largest
    if body.all():
        raise GeometryError(f"Everything is brighter than {level:g}; give another threshold.", level=level)
    return body


def _only_body(values: npt.NDArray[np.float32], body: npt.NDArray[np.bool_], level: float) -> Any:
    """Return the grey values with everything outside the body dark, nothing dark inside, and a dark border voxel."""
    dark = min(float(values.min()), 2.0 * level - float(values.max()))
    just_bright = np.nextafter(np.float32(level), np.float32(np.inf))
    around = np.where(values > level, dark, values)
    return np.pad(np.where(body, np.maximum(values, just_bright), around), 1, constant_values=dark)


def _simplified(points: Any, faces: Any) -> Mesh:
    """Return the largest closed part, oriented outwards, with at most `MOST_FACES` triangles."""
    from trimesh import Trimesh
    from trimesh.graph import connected_components

    mesh = Trimesh(points, faces, process=False)
    parts = connected_components(mesh.face_adjacency, nodes=np.arange(len(faces)))
    mesh.update_faces(max(parts, key=lambda part: float(mesh.area_faces[part].sum())))
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) > MOST_FACES:
        mesh = mesh.simplify_quadric_decimation(face_count=MOST_FACES)
    if mesh.volume < 0.0:
        mesh.invert()
    return Mesh(np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64))
