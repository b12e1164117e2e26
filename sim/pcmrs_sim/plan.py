"""The plans that a planner would have made for the phantoms: their landmarks, and twelve poses of the tool each.

``python -m pcmrs_sim.plan [FOLDER]`` writes ``ratms_plan.json`` and ``femoroplasty_plan.json``, and the phantoms'
surfaces ``head_phantom.ply`` and ``femur_phantom.ply`` in m, by default to ``examples``; the same numbers every time.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from math import cos, radians, sin
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs_sim import femur, head, surfaces
from pcmrs_sim.phantom import Phantom

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
TRAJECTORIES = (
    (0.45, 20, 8),
    (0.45, 20, 16),
    (0.45, 12, 8),
    (0.45, 28, 8),
    (0.45, 28, 16),
    (0.55, 16, 4),
    (0.55, 24, 4),
    (0.55, 24, 12),
    (0.55, 16, 12),
    (0.65, 22, 10),
    (0.65, 30, 12),
    (0.65, 14, 6),
)
"""Where drills end, as a part of the neck's length, and the way out from there: degrees inferior and posterior of
lateral."""
DECIMALS = 9
"""Of the numbers in a file, m and quaternion."""


def coil_pose(tilt_deg: float, azimuth_deg: float) -> Transform:
    """``image_from_coil`` with its origin on the scalp, +z the outward normal and +y as far anterior as it can be."""
    tilt, azimuth = radians(tilt_deg), radians(azimuth_deg)
    point = head.surface_point((sin(tilt) * sin(azimuth), sin(tilt) * cos(azimuth), cos(tilt)))
    return _pose(point, head.outward_normal(point), (0.0, 1.0, 0.0))


def guide_pose(depth: float, inferior_deg: float, posterior_deg: float) -> Transform:
    """``image_from_coil`` with its origin at the entry, +z the way out and +y as far superior as it can be."""
    entry, target = trajectory(depth, inferior_deg, posterior_deg)
    return _pose(entry, (entry - target) / np.linalg.norm(entry - target), (0.0, 0.0, 1.0))


def _pose(origin: Floats, z: Floats, up: tuple[float, float, float]) -> Transform:
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return Transform(np.column_stack((x, np.cross(z, x), z)), origin)


def trajectory(depth: float, inferior_deg: float, posterior_deg: float) -> tuple[Floats, Floats]:
    """Entry on the greater trochanter and target in the neck, in the image, m, (3,) each."""
    inferior, posterior = radians(inferior_deg), radians(posterior_deg)
    out = (cos(inferior) * cos(posterior), -cos(inferior) * sin(posterior), -sin(inferior))
    target = femur.BASE + depth * femur.NECK_LENGTH * femur.NECK_AXIS
    return femur.surface_point(target, out), target


def make_plan(phantom: Phantom, poses: Iterable[Transform]) -> dict[str, Any]:
    """A plan as plain data, in image coordinates and m.

    Returns:
        ``landmarks``, each with ``name`` and ``position``; ``poses``, each with ``position`` and ``quat_xyzw``.
    """
    return {
        "landmarks": [
            {"name": landmark.name, "position": landmark.position.round(DECIMALS).tolist()}
            for landmark in phantom.landmarks
        ],
        "poses": [
            {
                "position": pose.translation.round(DECIMALS).tolist(),
                "quat_xyzw": pose.quat_xyzw.round(DECIMALS).tolist(),
            }
            for pose in poses
        ],
    }


def make_plans() -> dict[str, dict[str, Any]]:
    """The plan of each workflow."""
    return {
        "ratms": make_plan(head.HEAD, (coil_pose(*site) for site in SITES_DEG)),
        "femoroplasty": make_plan(femur.FEMUR, (guide_pose(*course) for course in TRAJECTORIES)),
    }


def make_surfaces() -> dict[str, bytes]:
    """The surface of each phantom as a PLY file."""
    comment = "PCMRS {} phantom: image frame, RAS, m; made of formulas, of nobody"
    return {
        "head": surfaces.ply(*surfaces.head_surface(), comment.format("head")),
        "femur": surfaces.ply(*surfaces.femur_surface(), comment.format("femur")),
    }


def main(folder: Path) -> None:
    """Writes all plans and surfaces to `folder`."""
    for workflow, plan in make_plans().items():
        text = msgspec.json.format(msgspec.json.encode(plan), indent=2) + b"\n"
        (folder / f"{workflow}_plan.json").write_bytes(text)
    for phantom, mesh in make_surfaces().items():
        (folder / f"{phantom}_phantom.ply").write_bytes(mesh)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "examples"))
