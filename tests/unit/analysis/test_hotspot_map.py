"""The map of a search as a picture: whatever the search has come to, it is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from pcmrs.analysis.hotspot_map import hotspot_figure
from pcmrs.analysis.plots import save_png
from pcmrs.formats.mesh import Mesh, read_mesh
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import hand_area
from pcmrs.tms.settings import HotspotSettings
from tests import ROOT


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return read_mesh(ROOT / "examples" / "head_phantom.ply", "m", "RAS")


@pytest.fixture(scope="module")
def sparse(mesh: Mesh) -> Mesh:
    """A tenth of the triangles: drawing all of them takes seconds, and `test_session_folder` does."""
    return Mesh(mesh.vertices, mesh.faces[::10])


@pytest.mark.parametrize("amplitudes", [(10e-6,), (10e-6, 80e-6, 1e-3)])
@pytest.mark.parametrize("side", ["right", "left"])
def test_a_search_is_drawn_with_and_without_a_response(
    mesh: Mesh, sparse: Mesh, amplitudes: tuple[float, ...], side: Literal["right", "left"], tmp_path: Path
) -> None:
    closest = TriangleSurface(mesh.vertices, mesh.faces).closest
    centre = hand_area(closest, mesh.vertices[np.argmax(mesh.vertices[:, 2])], side)
    search = HotspotSearch.begin(HotspotSettings(rings=1), closest, centre)
    for amplitude in amplitudes:
        search = search.after(search.next(), amplitude)
    figure = hotspot_figure(sparse, search, "a search")
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert ("estimate" in labels) == search.responded
    assert "true hot-spot" not in labels
    picture = tmp_path / "map.png"
    save_png(figure, picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
