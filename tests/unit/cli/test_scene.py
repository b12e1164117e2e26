"""`pcmrs scene` records images without a cell, and says what is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.scene.cameras.recorded import write_frames
from pcmrs.scene.depth_frame import DepthFrame, Intrinsics
from pcmrs.testing.daemon import free_port

INTRINSICS = Intrinsics(width=16, height=8, fx=20.0, fy=20.0, cx=7.5, cy=3.5)


def scene(*words: str) -> Result:
    return CliRunner().invoke(main, ["scene", *words])


def recording(folder: Path) -> str:
    path = folder / "images.npz"
    depth = np.ones((8, 16), dtype=np.float32)
    write_frames(path, INTRINSICS, [DepthFrame(number, 0.01 * number, depth) for number in range(5)])
    return str(path)


def recorded(file: str) -> list[str]:
    return ["--set", "scene_camera.driver=recorded", "--set", f"scene_camera.file={file}"]


def test_images_are_recorded_without_a_cell(tmp_path: Path) -> None:
    copy = tmp_path / "copy.npz"
    ended = scene("--record", str(copy), "--frames", "3", "--json", *recorded(recording(tmp_path)))
    assert (ended.exit_code, ended.stdout) == (0, f'{{"file":"{copy}","frames":3}}\n')
    again = scene("--record", str(tmp_path / "again.npz"), *recorded(str(copy)))
    assert again.stdout.endswith(": 3 images\n")


def test_missing_file_or_library_is_named(tmp_path: Path) -> None:
    copy = str(tmp_path / "copy.npz")
    nothing = scene("--record", copy, "--set", "scene_camera.driver=recorded")
    assert (nothing.exit_code, "scene_camera.file is empty" in nothing.stderr) == (4, True)
    library = scene("--record", copy)
    assert (library.exit_code, "needs the package pyrealsense2" in library.stderr) == (4, True)
    broken = scene("--record", copy, *recorded(__file__))
    assert (broken.exit_code, "holds no depth images" in broken.stderr) == (5, True)


def test_without_a_cell_nothing_is_watched(tmp_path: Path) -> None:
    endpoint = f"cell.endpoint=tcp/127.0.0.1:{free_port()}"
    assert scene("--set", endpoint, *recorded(recording(tmp_path))).exit_code == 3
