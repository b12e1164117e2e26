"""Points that a simulated person touches anywhere lie on the phantom's true surface, where a hand can reach."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from pcmrs_sim import femur, head
from pcmrs_sim.phantoms import PHANTOMS, SURFACE_POINTS

COUNT = 300


@pytest.mark.parametrize("phantom", ["head", "femur"])
def test_points_lie_on_the_true_surface_and_repeat_by_seed(phantom: str) -> None:
    first, second = (np.random.default_rng(7) for _ in range(2))
    points = np.array([SURFACE_POINTS[phantom](first) for _ in range(COUNT)])
    assert np.array_equal(points, [SURFACE_POINTS[phantom](second) for _ in range(COUNT)])
    off = head.level(points) if phantom == "head" else femur.distances(points)
    assert np.abs(off).max() < 1e-9


def test_nobody_reaches_under_the_head() -> None:
    rng = np.random.default_rng(1)
    directions = np.array([SURFACE_POINTS["head"](rng) for _ in range(COUNT)]) - head.CENTRE
    assert not np.any((directions[:, 2] < 0.0) & (directions[:, 1] < 0.0))
    assert np.ptp(directions, axis=0).min() > 0.1, "they are spread over it"


@pytest.mark.parametrize("phantom", ["head", "femur"])
def test_the_tool_lies_behind_its_face(phantom: Literal["head", "femur"]) -> None:
    for shape in PHANTOMS[phantom].tool:
        cap = shape.size[0] if shape.kind == "capsule" else 0.0
        assert shape.pose.translation[2] - shape.size[1] - cap >= -1e-12
