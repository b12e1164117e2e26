"""The cost of a posture, by which inverse kinematics chooses among solutions; the same for every arm.

    cost = ‖q − seed‖ + DETOUR · Σ max(0, 1 − dᵢ / comfortᵢ)²

in rad, summed over every distance dᵢ that a posture should keep: of each joint from its nearer limit, from
singularities, and of the forearm (elbow to wrist) from the given spheres. Postures that are comfortable in all of these
are compared by their distance from the seed alone, so that motions stay short and a small change of the pose changes
the posture little. Avoiding a distance that is used up is worth a detour of `DETOUR`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats

DETOUR = 1.0  # rad
LIMIT_COMFORT = 0.17  # rad from a joint limit: 10 deg
SINGULAR_COMFORT = 0.17  # rad from a straight shoulder, elbow or wrist
SINGULAR_VALUE_COMFORT = (
    0.05  # smallest singular value of the Jacobian, m and rad mixed, for arms without a closed form
)
KEEP_AWAY_COMFORT = 0.10  # m from the surface of a sphere


def cost(arm: ArmModel, q: Floats, seed: Floats, keep_away: Floats | None = None) -> float:
    """Return the cost of a posture, rad.

    Args:
        arm: Model of the arm.
        q: Joint positions, rad, (n,).
        seed: Joint positions to stay close to, rad, (n,).
        keep_away: Spheres as returned by `sphere_array`, m, (M, 4), or None.
    """
    short = float(comfort_penalty(np.minimum(q - arm.lower, arm.upper - q), LIMIT_COMFORT).sum())
    short += float(_near_singular(arm, q).sum())
    if keep_away is not None:
        short += forearm_penalty(arm, q, keep_away)
    return float(np.linalg.norm(q - seed)) + DETOUR * short


def forearm_penalty(arm: ArmModel, q: Floats, keep_away: Floats) -> float:
    """Return the penalty of a forearm, from elbow to wrist, that is near spheres.

    Args:
        arm: Model of the arm.
        q: Joint positions, rad, (n,).
        keep_away: Spheres as returned by `sphere_array`, m, (M, 4).
    """
    forearm = arm.joint_origins(q)[-4:-1]
    distances = sphere_distances(forearm[:-1], forearm[1:], keep_away).min(axis=0)
    return float(comfort_penalty(distances, KEEP_AWAY_COMFORT).sum())


def comfort_penalty(distance: Floats, comfort: float) -> Floats:
    """Return the squared missing share of a comfortable distance: 0 from `comfort` on, 1 at distance 0, more below.

    Args:
        distance: Distances, in m or rad, of any shape.
        comfort: Distance from which on there is no penalty, in the same unit.
    """
    return np.square(np.maximum(0.0, 1.0 - distance / comfort))


def sphere_distances(start: Floats, end: Floats, spheres: Floats) -> Floats:
    """Return the distances of straight links from the surfaces of spheres, m, (N, M).

    Args:
        start: First ends of the links, m, (N, 3).
        end: Second ends of the links, m, (N, 3).
        spheres: Centres x, y, z and radii, m, (M, 4).
    """
    segment = (end - start)[:, None]
    offset = spheres[None, :, :3] - start[:, None]
    length = np.maximum(np.sum(segment * segment, axis=-1), 1e-12)  # a link without length is a point
    share = np.clip(np.sum(offset * segment, axis=-1) / length, 0.0, 1.0)
    clearances: Floats = np.linalg.norm(offset - share[..., None] * segment, axis=-1) - spheres[:, 3]
    return clearances


def sphere_array(keep_away: npt.ArrayLike) -> Floats:
    """Return spheres as an array of x, y, z and radius in the robot's base, m, (M, 4)."""
    return np.asarray(keep_away, dtype=float).reshape(-1, 4)


def _near_singular(arm: ArmModel, q: Floats) -> Floats:
    if arm.geometry is not None:
        return comfort_penalty(arm.geometry.singular_angles(q), SINGULAR_COMFORT)
    values = np.asarray(np.linalg.svd(arm.jacobian(q), compute_uv=False), dtype=float)
    return comfort_penalty(values[-1:], SINGULAR_VALUE_COMFORT)
