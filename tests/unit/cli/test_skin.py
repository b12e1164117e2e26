"""`pcmrs skin` from a volume to a mesh that a cell can be configured with."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.formats.mesh import read_mesh

nibabel = pytest.importorskip("nibabel")
pytest.importorskip("skimage")


def ball(folder: Path) -> Path:
    """A volume of a ball with a diameter of 60 mm."""
    points = np.stack(np.meshgrid(*[np.arange(40.0)] * 3, indexing="ij"), axis=-1) - 19.5
    values = (np.linalg.norm(points, axis=-1) < 15.0).astype(np.int16) * 100
    volume = folder / "ball.nii.gz"
    nibabel.save(nibabel.Nifti1Image(values, np.diag((2.0, 2.0, 2.0, 1.0))), volume)
    return volume


def test_a_mesh_is_written_that_can_be_read(tmp_path: Path) -> None:
    volume, out = ball(tmp_path), tmp_path / "ball.ply"
    ended = CliRunner().invoke(main, ["skin", str(volume), "-o", str(out), "--json", "--any-size"])
    assert ended.exit_code == 0, ended.stderr
    said = json.loads(ended.stdout)
    assert said["closed"] is True
    assert said["edges_mm"] == pytest.approx([60.0] * 3, abs=2.0)
    mesh = read_mesh(out, "m", "RAS")
    assert len(mesh.faces) == said["faces"]
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), 0.039, atol=0.001)


@pytest.mark.parametrize(("answer", "status"), [("", 5), ("n\n", 5), ("y\n", 0)])
def test_an_implausible_size_is_asked_about(tmp_path: Path, answer: str, status: int) -> None:
    volume, out = ball(tmp_path), tmp_path / "ball.ply"
    ended = CliRunner().invoke(main, ["skin", str(volume), "-o", str(out)], input=answer)
    assert ended.exit_code == status
    assert "The body measures 6" in ended.stderr
    assert out.exists() == (status == 0)


def test_unreadable_file_gives_one_error_line_and_no_output(tmp_path: Path) -> None:
    (tmp_path / "head.nii").write_bytes(b"nonsense")
    ended = CliRunner().invoke(main, ["skin", str(tmp_path / "head.nii"), "-o", str(tmp_path / "head.ply")])
    assert ended.exit_code == 5
    assert "does not begin with a header" in ended.stderr
    assert not (tmp_path / "head.ply").exists()
