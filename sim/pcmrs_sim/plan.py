"""Plans for the phantoms, as a planner makes them: the landmarks, and twelve poses of the tool.

``python -m pcmrs_sim.plan [FOLDER]`` writes ``ratms_plan.json`` and ``femoroplasty_plan.json``, and the phantoms'
surfaces ``head_phantom.ply`` and ``femur_phantom.ply`` in m, by default to ``examples``. The files are the same each
time.
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
"""Sites of the coil, seen from the centre of the head, degrees: tilt from superior, azimuth from anterior to right."""
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
"""Drill trajectories: target, as a fraction of the neck's length, and direction from there to the entry, in degrees
inferior and posterior of lateral."""
DECIMALS = 9
"""Decimals of positions, in m, and of quaternions in a file."""


def coil_pose(tilt_deg: float, azimuth_deg: float) -> Transform:
    """Return ``image_from_coil``: origin on the scalp, +z along the outward normal, +y as anterior as possible.

    Args:
        tilt_deg: Angle of the site from superior, seen from the centre of the head, degrees.
        azimuth_deg: Angle of the site from anterior to the right, degrees.
    """
    tilt, azimuth = radians(tilt_deg), radians(azimuth_deg)
    point = head.surface_point((sin(tilt) * sin(azimuth), sin(tilt) * cos(azimuth), cos(tilt)))
    return _pose(point, head.outward_normal(point), (0.0, 1.0, 0.0))


def guide_pose(depth: float, inferior_deg: float, posterior_deg: float) -> Transform:
    """Return ``image_from_coil``: origin at the entry, +z from target to entry, +y as superior as possible.

    Args:
        depth: Target, as a fraction of the neck's length.
        inferior_deg: Direction from target to entry, degrees inferior of lateral.
        posterior_deg: Direction from target to entry, degrees posterior of lateral.
    """
    entry, target = trajectory(depth, inferior_deg, posterior_deg)
    return _pose(entry, (entry - target) / np.linalg.norm(entry - target), (0.0, 0.0, 1.0))


def _pose(origin: Floats, z: Floats, up: tuple[float, float, float]) -> Transform:
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return Transform(np.column_stack((x, np.cross(z, x), z)), origin)


def trajectory(depth: float, inferior_deg: float, posterior_deg: float) -> tuple[Floats, Floats]:
    """Return the entry on the greater trochanter and the target in the neck, in the image, m, (3,) each.

    Args:
        depth: Target, as a fraction of the neck's length.
        inferior_deg: Direction from target to entry, degrees inferior of lateral.
        posterior_deg: Direction from target to entry, degrees posterior of lateral.
    """
    inferior, posterior = radians(inferior_deg), radians(posterior_deg)
    out = (cos(inferior) * cos(posterior), -cos(inferior) * sin(posterior), -sin(inferior))
    target = femur.BASE + depth * femur.NECK_LENGTH * femur.NECK_AXIS
    return femur.surface_point(target, out), target


def make_plan(phantom: Phantom, poses: Iterable[Transform]) -> dict[str, Any]:
    """Return a plan as plain data, in the image frame and m.

    Args:
        phantom: Phantom with the landmarks.
        poses: Poses of the tool, ``image_from_coil``.

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
    """Return the name of each workflow with its plan."""
    return {
        "ratms": make_plan(head.HEAD, (coil_pose(*site) for site in SITES_DEG)),
        "femoroplasty": make_plan(femur.FEMUR, (guide_pose(*drill) for drill in TRAJECTORIES)),
    }


def make_surfaces() -> dict[str, bytes]:
    """Return the name of each phantom with its surface as a PLY file."""
    comment = "PCMRS {} phantom: image frame, RAS, m; made of formulas, of nobody"
    return {
        "head": surfaces.ply(*surfaces.head_surface(), comment.format("head")),
        "femur": surfaces.ply(*surfaces.femur_surface(), comment.format("femur")),
    }


def main(folder: Path) -> None:
    """Write all plans and surfaces to a folder."""
    for workflow, plan in make_plans().items():
        text = msgspec.json.format(msgspec.json.encode(plan), indent=2) + b"\n"
        (folder / f"{workflow}_plan.json").write_bytes(text)
    for phantom, mesh in make_surfaces().items():
        (folder / f"{phantom}_phantom.ply").write_bytes(mesh)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "examples"))
