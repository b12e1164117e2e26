"""What makes one posture better than another: one cost, for every arm.

    cost = ‖q − seed‖ + DETOUR · Σ max(0, 1 − dᵢ / comfortᵢ)²

in rad, over every distance dᵢ that a posture should keep: of each joint from its nearer limit; from singularities; and
of the forearm, from the elbow to the wrist, from what it is told to keep away from. A posture that is comfortable in
all of them is judged by the way from the seed alone, so that motions stay short and small changes of a pose change the
posture little; to avoid one that has used up a distance, a detour of `DETOUR` is worth while.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats

DETOUR = 1.0  # rad
LIMIT_COMFORT = 0.17  # rad from a joint limit: 10 deg
SINGULAR_COMFORT = 0.17  # rad from a straight shoulder, elbow or wrist
SINGULAR_VALUE_COMFORT = 0.05  # smallest singular value of the Jacobian, m and rad mixed, of arms without those
KEEP_AWAY_COMFORT = 0.10  # m from the surface of a sphere


def cost(arm: ArmModel, q: Floats, seed: Floats, keep_away: Floats | None = None) -> float:
    """The cost of joint positions `q`, rad; see the module for `seed`, and `spheres` for `keep_away`."""
    short = float(shortage(np.minimum(q - arm.lower, arm.upper - q), LIMIT_COMFORT).sum())
    short += float(_near_singular(arm, q).sum())
    if keep_away is not None:
        forearm = arm.origins(q)[-4:-1]
        short += float(shortage(distances(forearm[:-1], forearm[1:], keep_away).min(axis=0), KEEP_AWAY_COMFORT).sum())
    return float(np.linalg.norm(q - seed)) + DETOUR * short


def shortage(distance: Floats, comfort: float) -> Floats:
    """How much of a comfortable distance is missing, squared: 0 from there on, 1 where it is used up, more beyond."""
    return np.square(np.maximum(0.0, 1.0 - distance / comfort))


def distances(start: Floats, end: Floats, spheres: Floats) -> Floats:
    """Distances of straight links (N, 3) to (N, 3) from the surfaces of spheres (M, 4), m, (N, M)."""
    way = (end - start)[:, None]
    offset = spheres[None, :, :3] - start[:, None]
    length = np.maximum(np.sum(way * way, axis=-1), 1e-12)  # a link without length is a point
    share = np.clip(np.sum(offset * way, axis=-1) / length, 0.0, 1.0)
    away: Floats = np.linalg.norm(offset - share[..., None] * way, axis=-1) - spheres[:, 3]
    return away


def spheres(keep_away: npt.ArrayLike) -> Floats:
    """Spheres to keep away from as an array of x, y, z and radius in the base, m, (M, 4)."""
    return np.asarray(keep_away, dtype=float).reshape(-1, 4)


def _near_singular(arm: ArmModel, q: Floats) -> Floats:
    if arm.spherical:
        return shortage(np.abs(q[[1, 3, 5]]), SINGULAR_COMFORT)
    values = np.asarray(np.linalg.svd(arm.jacobian(q), compute_uv=False), dtype=float)
    return shortage(values[-1:], SINGULAR_VALUE_COMFORT)
