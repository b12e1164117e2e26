"""The body's surface: where its file is found, and whose it may be."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from structlog.testing import capture_logs

from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.workflows.surface import read_surface
from tests.unit.workflows.zone_bench import settings_with

TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
100 0 0
0 100 0
0 0 100
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""


def test_missing_surface_is_logged_at_the_start() -> None:
    with capture_logs() as logs:
        assert read_surface(settings_with()) is None
    assert [log["event"] for log in logs] == ["no_body_surface"]


def test_surface_is_found_in_the_folders_then_among_examples(tmp_path: Path) -> None:
    (tmp_path / "own.ply").write_text(TETRAHEDRON)
    own = read_surface(settings_with(surface="own.ply", folders=[str(tmp_path)], unit="mm", space="LPS"))
    assert own is not None
    assert own.vertices.min(axis=0) == pytest.approx((-0.1, -0.1, 0.0))
    assert read_surface(settings_with(surface=str(tmp_path / "own.ply"))) is not None
    head = read_surface(settings_with(surface="head_phantom.ply", folders=[str(tmp_path)]))
    assert head is not None
    assert np.ptp(head.vertices, axis=0) == pytest.approx((0.156, 0.196, 0.216), abs=0.06)
    with pytest.raises(ConfigurationError, match=r"there is no .*nobody\.ply"):
        read_surface(settings_with(surface="nobody.ply"))
    (tmp_path / "own.ply").write_text("ply")
    with pytest.raises(FileFormatError):
        read_surface(settings_with(surface="own.ply", folders=[str(tmp_path)]))


def test_a_phantom_is_no_patient() -> None:
    mine = msgspec.structs.replace(settings_with(surface="head_phantom.ply"), patient="P-17")
    with pytest.raises(ConfigurationError, match=r"phantom's, but the patient is P-17: set it to the patient's own"):
        read_surface(mine)
