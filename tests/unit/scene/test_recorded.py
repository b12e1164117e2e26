"""Recorded depth images come back as they were, and a file that holds none is refused."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from pcmrs.errors import FileFormatError
from pcmrs.scene.cameras.recorded import RecordedCamera, write_frames
from pcmrs.scene.depth_frame import DepthFrame, Intrinsics
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.loop import run_on_simulated_loop

INTRINSICS = Intrinsics(width=16, height=8, fx=20.0, fy=20.0, cx=7.5, cy=3.5)


def frame(number: int, depth: float) -> DepthFrame:
    return DepthFrame(number, 100.0 + 0.5 * number, np.full((8, 16), depth, dtype=np.float32))


def test_images_come_back_at_their_pace(tmp_path: Path) -> None:
    path = tmp_path / "empty.npz"
    write_frames(path, INTRINSICS, [frame(0, 1.2344), frame(1, 0.0), frame(2, 99.0)])

    async def play() -> tuple[list[DepthFrame], float]:
        clock = SimulatedClock(asyncio.get_running_loop())
        camera, start = RecordedCamera(path, clock), clock.monotonic()
        assert camera.intrinsics == INTRINSICS
        return [each async for each in camera.frames()], clock.monotonic() - start

    frames, duration = run_on_simulated_loop(play())
    assert duration == pytest.approx(1.0)
    assert [round(float(each.depth[0, 0]), 3) for each in frames] == [1.234, 0.0, 65.535]
    assert frames[1].captured - frames[0].captured == pytest.approx(0.5)


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 cut", b"\x93NUMPY", b"text"], ids=["empty", "zip", "npy", "text"]
)
def test_file_without_images_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "broken.npz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="holds no depth images"):
        RecordedCamera(path, SimulatedClock(None))  # type: ignore[arg-type]


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "small.npz"
    small = DepthFrame(0, 0.0, np.ones((4, 4), dtype=np.float32))
    write_frames(path, INTRINSICS, [small])
    with pytest.raises(FileFormatError, match=r"shape \(1, 4, 4\), not of \(1, 8, 16\)"):
        RecordedCamera(path, SimulatedClock(None))  # type: ignore[arg-type]
