"""Pictures of the cell, and what is refused. MuJoCo chooses its renderer when it is imported: so in a new process."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from pcmrs_sim.cli import main


def render(output: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from pcmrs_sim.cli import main; main()", "render", "-o", str(output), *options]
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_a_film_shows_the_pointer_at_a_landmark(tmp_path: Path) -> None:
    schedule, film = tmp_path / "lines.txt", tmp_path / "cell.png"
    schedule.write_text("0.0 touch 0\n", encoding="utf-8")
    size = ("--width", "160", "--height", "96")
    quick = ("--set", "sim.arm.physics=kinematic", "--set", "sim.digitization.reach_time=0.05")
    ended = render(film, "--duration", "0.2", "--schedule", str(schedule), *size, *quick)
    assert ended.returncode == 0, ended.stderr
    assert "5 pictures of 160 x 96 pixels" in ended.stdout
    with Image.open(film) as image:
        frames = []
        for number in range(image.n_frames):  # type: ignore[attr-defined]
            image.seek(number)
            frames.append(np.asarray(image.convert("RGB"), dtype=int))
    assert len(frames) == 5
    assert frames[0].std() > 20.0, "something is shown"
    changed = np.abs(frames[-1] - frames[0]).max(axis=2) > 30
    assert 5 < changed.sum() < 3000, "the pointer has come, and the rest stands"
    assert not film.with_suffix(".part").exists()


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["-o", "cell.mp4"], 4, "ffmpeg -i cell.png cell.mp4"),
        (["-o", "nowhere/cell.png"], 4, "nowhere"),
        (["-o", "cell.png", "--duration", "1000"], 2, "1000"),
        (["-o", "cell.png", "--camera", "ceiling"], 2, "ceiling"),
    ],
)
def test_impossible_pictures_are_refused_with_the_remedy(arguments: list[str], status: int, text: str) -> None:
    ended = CliRunner().invoke(main, ["render", *arguments])
    assert ended.exit_code == status
    assert text in ended.stderr
