"""A draft on a ball."""

from __future__ import annotations

import numpy as np
import trimesh

from pcmrs.console.planning._draft import Draft
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats

RADIUS = 0.09
BALL = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
SCALP = TriangleSurface(BALL.vertices, BALL.faces)


def draft() -> Draft:
    return Draft(surface=SCALP)


def direction(seed: int) -> Floats:
    found: Floats = np.random.default_rng(seed).normal(size=3)
    return found / np.linalg.norm(found)
