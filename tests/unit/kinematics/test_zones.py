"""Distances of links and zones, against geometry worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from pcmrs.kinematics.zones import MOUNT_RADIUS, SIGHT_OF_BODY, SIGHT_OF_TOOL
from pcmrs.spatial import Floats, Transform
from tests.support.trials import examples
from tests.unit.kinematics.zone_cell import (
    ARM,
    CORNERS,
    FACTS,
    FLANGE_FROM_TOOL,
    MARKER_IN_FLANGE,
    SIGHT,
    seeds,
    zone_model,
)


def link_ends(q: Floats) -> dict[str, tuple[Floats, Floats]]:
    """Both ends of the axis of every link, by the joint facts alone."""
    pose, ends = Transform.identity(), {"base": (np.zeros(3), np.array(FACTS.joints[0].xyz, dtype=float))}
    offsets = [*(joint.xyz for joint in FACTS.joints[1:]), FACTS.flange_xyz]
    for number, (joint, angle, offset) in enumerate(zip(FACTS.joints, q, offsets, strict=True), start=1):
        pose = pose @ joint.parent_from_joint @ Transform.from_rotvec(np.zeros(3), (0.0, 0.0, angle))
        ends[f"link_{number}"] = (pose.translation, pose @ np.array(offset, dtype=float))
    flange = Transform(pose.rotation, pose @ np.array(FACTS.flange_xyz, dtype=float))
    ends["mount"] = (flange.translation, flange @ FLANGE_FROM_TOOL @ np.array((0.0, 0.0, 0.02)))
    return ends


def along(ends: tuple[Floats, Floats], count: int = 2001) -> Floats:
    return ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])


def point_to_segment(points: Floats, ends: tuple[Floats, Floats]) -> float:
    line = ends[1] - ends[0]
    parts = np.clip((points - ends[0]) @ line / (line @ line), 0.0, 1.0)
    return float(np.linalg.norm(points - ends[0] - parts[:, None] * line, axis=1).min())


def radius_of(link: str) -> float:
    return MOUNT_RADIUS if link == "mount" else FACTS.link_radius


def random_posture(seed: int) -> Floats:
    return np.random.default_rng(seed).uniform(ARM.lower, ARM.upper)


@examples(25)
@given(seeds)
def test_links_are_as_far_apart_as_their_axes_less_their_radii(seed: int) -> None:
    q, model = random_posture(seed), zone_model()
    ends = link_ends(q)
    for (a, b), distance in zip(model.pairs, model.distances(q), strict=True):
        if a in ends and b in ends and distance > 0.0:
            expected = point_to_segment(along(ends[a]), ends[b]) - radius_of(a) - radius_of(b)
            assert distance == pytest.approx(expected, abs=1e-4)


@examples(25)
@given(seeds)
def test_links_are_as_far_from_a_cube_as_points_of_their_axes(seed: int) -> None:
    rng, q, model = np.random.default_rng(seed), random_posture(seed), zone_model()
    base_from_body = Transform.from_rotvec(rng.uniform(-0.8, 0.8, 3), rng.uniform(-1.0, 1.0, 3))
    model.place("body", base_from_body)
    ends = link_ends(q)
    for (link, zone), distance in zip(model.pairs, model.distances(q), strict=True):
        if zone == "body" and link in ends and distance > 0.0:
            points = base_from_body.inverse() @ along(ends[link])
            outside = np.linalg.norm(np.maximum(np.abs(points) - 0.1, 0.0), axis=1).min()
            assert distance == pytest.approx(outside - radius_of(link), abs=1e-4)


def test_the_tool_is_a_disc_that_rests_on_the_tool_point() -> None:
    model = zone_model()
    flange = ARM.forward(np.zeros(7))
    point = (flange @ FLANGE_FROM_TOOL).translation
    assert point[2] == pytest.approx(flange.translation[2] + 0.15), "the arm stands upright, the tool on top"
    model.place("body", Transform(np.eye(3), point + np.array((0.0, 0.0, 0.1 + 0.025))))
    distances = dict(zip(model.pairs, model.distances(np.zeros(7)), strict=True))
    assert distances["tool", "body"] == pytest.approx(0.025, abs=1e-6)
    model.place("body", Transform(np.eye(3), point + np.array((0.05 + 0.1 + 0.02, 0.0, 0.0))))
    distances = dict(zip(model.pairs, model.distances(np.zeros(7)), strict=True))
    assert distances["tool", "body"] == pytest.approx(0.02, abs=1e-6)


def test_a_ball_holds_the_whole_body_where_it_is() -> None:
    model, base_from_body = zone_model(), Transform.from_rotvec((0.4, -0.2, 0.3), (0.3, 0.5, 0.0))
    model.place("body", base_from_body)
    ball = model.bounding_sphere("body")
    np.testing.assert_allclose(ball, (0.4, -0.2, 0.3, 0.1 * np.sqrt(3.0)), atol=1e-12)
    assert np.all(np.linalg.norm(base_from_body @ CORNERS - ball[:3], axis=1) <= ball[3] + 1e-12)


def test_each_pair_belongs_to_its_zone_only() -> None:
    model = zone_model()
    for zone in ("body", "table", SIGHT_OF_TOOL, SIGHT_OF_BODY, "link_7", "nothing"):
        chosen = [pair for pair, chosen in zip(model.pairs, model.pairs_of_zone(zone), strict=True) if chosen]
        assert chosen == [pair for pair in model.pairs if pair[1] == zone]
        assert bool(chosen) == (zone != "nothing")


def test_overlapping_bodies_have_a_negative_distance() -> None:
    model, q = zone_model(), np.zeros(7)
    model.place("body", Transform(np.eye(3), np.array((0.15, 0.0, 0.46))))
    distances = dict(zip(model.pairs, model.distances(q), strict=True))
    assert distances["link_2", "body"] == pytest.approx(0.05 - FACTS.link_radius, abs=1e-5)


@examples(20)
@given(seeds)
def test_lines_of_sight_end_at_both_marker_bodies(seed: int) -> None:
    rng, q, model = np.random.default_rng(seed), random_posture(seed), zone_model()
    tracker, body_ref = rng.uniform(-1.5, 1.5, (2, 3))
    model.set_sight_lines(tracker, body_ref)
    ends = link_ends(q)
    marker = ARM.forward(q) @ MARKER_IN_FLANGE
    sights = {SIGHT_OF_TOOL: (tracker, marker), SIGHT_OF_BODY: (tracker, body_ref)}
    found = dict(zip(model.pairs, model.distances(q), strict=True))
    for (link, zone), distance in found.items():
        if zone in sights and link in ends and distance > 0.0:
            expected = point_to_segment(along(ends[link]), sights[zone]) - radius_of(link) - SIGHT
            assert distance == pytest.approx(expected, abs=1e-4)
    assert ("tool", SIGHT_OF_TOOL) not in found, "the tool carries the markers"
    assert ("tool", SIGHT_OF_BODY) in found


def test_unplaced_zone_is_far_away() -> None:
    model = zone_model()
    unplaced = [zone in ("body", "table", SIGHT_OF_BODY, SIGHT_OF_TOOL) for _, zone in model.pairs]
    assert model.distances(np.zeros(7))[unplaced].min() > 100.0


def test_neighbours_are_not_watched_and_all_other_links_are() -> None:
    pairs = set(zone_model().pairs)
    assert ("link_2", "link_3") not in pairs
    assert ("link_7", "mount") not in pairs
    for expected in (("base", "link_4"), ("link_2", "link_4"), ("link_3", "link_5"), ("link_1", "tool")):
        assert expected in pairs
    assert not any(link == "base" and zone in ("body", "table") for link, zone in pairs)


def test_an_arm_folded_upon_itself_is_noticed() -> None:
    model = zone_model()
    assert np.all(model.distances(FACTS.home) > model.limits)
    distances = model.distances((0.0, -1.92, 0.33, 2.09, -1.07, -1.31, 0.24))
    found = model.clearance(distances, int(np.argmin(distances - model.limits)))
    assert (found.link, found.zone, found.limit) == ("base", "link_7", 0.01)
    assert found.distance < 0.0
