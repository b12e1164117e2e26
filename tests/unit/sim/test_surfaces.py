"""The example meshes are the phantoms' own surfaces, as another library reads them."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from pcmrs.formats.mesh import read_mesh
from pcmrs.spatial import Floats
from pcmrs_sim import femur, head
from pcmrs_sim.phantom import PhantomLandmark
from tests import ROOT

EXAMPLES = ROOT / "examples"
PHANTOMS = [("head", head.level), ("femur", femur.distances)]
Field = Callable[[Floats], Floats]


@pytest.mark.parametrize(("name", "field"), PHANTOMS)
def test_a_surface_is_closed_on_the_phantom_and_faces_outwards(name: str, field: Field) -> None:
    path = EXAMPLES / f"{name}_phantom.ply"
    assert path.stat().st_size < 300_000
    mesh = read_mesh(path, "m", "RAS")
    assert np.abs(field(mesh.vertices)).max() < 1e-5
    corners = mesh.vertices[mesh.faces]
    edges = np.sort(np.concatenate([mesh.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middles = corners.mean(axis=1)
    assert (field(middles + 1e-3 * normals) > field(middles - 1e-3 * normals)).mean() > 0.999
    assert np.abs(field(middles)).max() < 1e-2


def test_the_head_has_the_volume_of_its_formula() -> None:
    """Barr's superellipsoid, by a fine sum over its box."""
    mesh = read_mesh(EXAMPLES / "head_phantom.ply", "m", "RAS")
    axes = [np.linspace(-1.0, 1.0, 101)[:-1] + 0.01] * 3
    powers = np.abs(np.meshgrid(*axes, indexing="ij")) ** head.EXPONENT
    inside = powers.sum(axis=0) < 1.0
    volume = inside.mean() * 8.0 * np.prod(head.SEMI_AXES)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume == pytest.approx(volume, rel=0.005)


@pytest.mark.parametrize(("name", "landmarks"), [("head", head.LANDMARKS[:1]), ("femur", femur.LANDMARKS)])
def test_landmarks_on_the_skin_lie_on_the_mesh(name: str, landmarks: tuple[PhantomLandmark, ...]) -> None:
    mesh = read_mesh(EXAMPLES / f"{name}_phantom.ply", "m", "RAS")
    for landmark in landmarks:
        assert np.linalg.norm(mesh.vertices - landmark.position, axis=1).min() < 0.005
