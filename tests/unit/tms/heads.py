"""Scalps to search on: a sphere, on which everything is known, and the head phantom."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from pcmrs.formats.mesh import read_mesh
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import hand_area
from pcmrs_sim.tms.recruitment import Recruitment
from tests import ROOT

RADIUS = 0.085


def sphere(points: Floats) -> tuple[Floats, Floats]:
    """A scalp around the origin."""
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    return RADIUS * normals, normals


TOP = Transform(np.eye(3), np.array((0.0, 0.0, RADIUS)))


@cache
def phantom() -> tuple[TriangleSurface, Transform]:
    """The head phantom, and the usual pose over its hand area."""
    mesh = read_mesh(ROOT / "examples" / "head_phantom.ply", "m", "RAS")
    surface = TriangleSurface(mesh.vertices, mesh.faces)
    return surface, hand_area(surface.closest, mesh.vertices[np.argmax(mesh.vertices[:, 2])])


@dataclass(frozen=True)
class Steady(Recruitment):
    """A muscle without variability: a sigmoid of the intensity in the logarithm of the amplitude."""

    def sample(self, intensity: float, rng: np.random.Generator) -> float:
        """From 10 uV far below the threshold to 5 mV far above."""
        share = 1.0 / (1.0 + np.exp(-(intensity / self.threshold - 1.1) / 0.06))
        return float(10.0 ** (-5.0 + 2.7 * share))
