"""PNG files as another library reads them."""

import io

import numpy as np
import pytest
from PIL import Image

from pcmrs_sim.cli.png import Picture, PngFile


def pictures(count: int) -> list[Picture]:
    rng = np.random.default_rng(1)
    return [rng.integers(0, 256, (5, 7, 3), dtype=np.uint8) for _ in range(count)]


@pytest.mark.parametrize("count", [1, 4])
def test_every_frame_is_read_back_exactly(count: int) -> None:
    frames, file = pictures(count), PngFile(count, 25)
    with Image.open(io.BytesIO(b"".join(map(file.add, frames)))) as image:
        assert getattr(image, "n_frames", 1) == count
        for number, frame in enumerate(frames):
            image.seek(number)
            assert np.array_equal(np.asarray(image.convert("RGB")), frame)
            assert count == 1 or image.info["duration"] == 40.0
