"""Files of poses: saved placements, pose logs, poses for a calibration, calibrations, and those of the lab.

Each is read, or refused by name.

python -m fuzz.pose_files -max_total_time=60
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from fuzz.running import UploadedFile, instrumented, run

with instrumented("pcmrs.formats", "pcmrs.calibration", "yaml"):
    from pcmrs.calibration import read_calibration
    from pcmrs.calibration.poses import HAND_EYE, read_poses, read_touches
    from pcmrs.errors import FileFormatError
    from pcmrs.formats.lab_yaml import read_lab_calibration, read_lab_cloud, read_lab_pose
    from pcmrs.formats.pose_file import read_placements
    from pcmrs.formats.pose_log import read_pose_log

read_hand_eye = partial(read_poses, names=HAND_EYE)
read_touched = partial(read_touches, tip_in_pointer=np.array((0.0, 0.0, -0.15)))
READERS: dict[str, Callable[[Path], object]] = {
    "placement.yaml": read_placements,
    "log.csv": read_pose_log,
    "poses.csv": read_hand_eye,
    "poses.json": read_hand_eye,
    "calibration.toml": read_calibration,
    "touches.csv": read_touched,
    "tool_toolref.yaml": read_lab_calibration,
    "reg.yaml": read_lab_pose,
    "icpdig.yaml": lambda path: (read_lab_cloud(path),),
}
FILE = UploadedFile(*READERS)


def one(data: bytes) -> None:
    """Read a file; the first byte selects its kind."""
    path = FILE.write(data)
    try:
        assert READERS[path.name](path)
    except FileFormatError as error:
        assert path.name in error.text  # noqa: PT017  # not a test: libFuzzer finds inputs that raise


if __name__ == "__main__":
    run(one)
