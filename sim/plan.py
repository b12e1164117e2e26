"""The plan that a planner would have made for the phantom: six landmarks and twelve coil poses.

``python -m sim.plan [FILE]`` writes it, by default to ``examples/ratms_plan.json``; the same numbers every time.
"""

from __future__ import annotations

import sys
from math import cos, radians, sin
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pcmrs.spatial import Transform
from sim.phantom import LANDMARKS, landmark_position, outward_normal, surface_point

SITES_DEG = (
    (0, 0),
    (25, 0),
    (25, 90),
    (25, -90),
    (45, 90),
    (45, -90),
    (65, 90),
    (65, -90),
    (45, 45),
    (45, -45),
    (60, 60),
    (60, -60),
)
"""Where the coil goes, seen from the centre of the head: tilt from superior, azimuth from anterior to the right."""
DECIMALS = 9
"""Of the numbers in the file, m and quaternion."""


def coil_pose(tilt_deg: float, azimuth_deg: float) -> Transform:
    """``image_from_coil`` with its origin on the scalp, +z the outward normal and +y as far anterior as it can be."""
    tilt, azimuth = radians(tilt_deg), radians(azimuth_deg)
    point = surface_point((sin(tilt) * sin(azimuth), sin(tilt) * cos(azimuth), cos(tilt)))
    z = outward_normal(point)
    x = np.cross((0.0, 1.0, 0.0), z)
    x /= np.linalg.norm(x)
    return Transform(np.column_stack((x, np.cross(z, x), z)), point)


def make_plan() -> dict[str, Any]:
    """The plan as plain data, in image coordinates and m.

    Returns:
        ``landmarks``, each with ``name`` and ``position``; ``poses``, each with ``position`` and ``quat_xyzw``.
    """
    poses = [coil_pose(tilt, azimuth) for tilt, azimuth in SITES_DEG]
    return {
        "landmarks": [
            {"name": landmark.name, "position": landmark_position(landmark).round(DECIMALS).tolist()}
            for landmark in LANDMARKS
        ],
        "poses": [
            {
                "position": pose.translation.round(DECIMALS).tolist(),
                "quat_xyzw": pose.quat_xyzw.round(DECIMALS).tolist(),
            }
            for pose in poses
        ],
    }


def main(path: Path) -> None:
    """Writes the plan to `path`."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(make_plan()), indent=2) + b"\n")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "examples/ratms_plan.json"))
