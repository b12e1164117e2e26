"""Objects in zones are clusters that are large enough; each zone finds its own."""

from __future__ import annotations

import numpy as np

from pcmrs.scene._clusters import BoxZone, Cluster, find_clusters
from pcmrs.spatial import Transform

TURNED = Transform.from_rotvec((0.5, 0.0, 0.5), (0.0, 0.0, np.pi / 4))
BENCH = BoxZone("bench", TURNED, np.array((0.4, 0.4, 0.4)))
DOOR = BoxZone("door", Transform.from_rotvec((0.0, 2.0, 0.5), (0.0, 0.0, 0.0)), np.array((1.0, 1.0, 2.0)))


def ball(x: float, y: float, z: float, radius: float = 0.05, count: int = 60) -> np.ndarray:
    rng = np.random.default_rng(count)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.asarray(np.array((x, y, z)) + radius * directions)


def found(*balls: np.ndarray) -> list[Cluster]:
    points = np.concatenate(balls)
    return list(find_clusters(points, [BENCH, DOOR], voxel=0.04, least_points=10, least_extent=0.05))


def test_two_objects_in_a_zone_are_two_clusters() -> None:
    clusters = found(ball(0.4, 0.0, 0.5), ball(0.6, 0.0, 0.5))
    assert sorted(round(each.middle[0], 1) for each in clusters) == [0.4, 0.6]
    assert {each.zone for each in clusters} == {"bench"}
    assert all(0.08 < each.extent <= 0.1 for each in clusters)


def test_object_outside_of_all_zones_is_none() -> None:
    assert found(ball(0.7, 0.2, 0.5, radius=0.02), ball(-1.0, 0.0, 0.0)) == [], "beyond the edge of a turned box"


def test_each_zone_finds_its_own() -> None:
    assert [each.zone for each in found(ball(0.0, 2.0, 1.0))] == ["door"]


def test_specks_are_no_objects() -> None:
    assert found(ball(0.5, 0.0, 0.5, count=9)) == []
    assert found(ball(0.5, 0.0, 0.5, radius=0.01)) == []
