"""Coverage against refinements with the points that it recommends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.registration import predict_tre
from pcmrs.registration.coverage import PLACES, REGIONS, Region, SurfaceCoverage, surface_coverage
from pcmrs.registration.surface import OffsetPrior, refine_with_surface
from pcmrs.spatial import Floats
from tests.unit.registration.heads import HEADS, TouchedHead, evenly

BOTH = (OffsetPrior("hair", 0.002, 0.003, 0.008), OffsetPrior("face", 0.0, 0.001, 0.008))
NO_POINTS = np.empty((0, 3))
PHANTOM = HEADS["phantom"]


def coverage(head: TouchedHead, seed: int, **given: Any) -> SurfaceCoverage:
    return surface_coverage(**head.session(seed, **({"offsets": BOTH} | given)))


def within(head: TouchedHead, region: Region, count: int) -> Floats:
    """Directions whose normals are most of all those of a region, evenly over the area, (count, 3)."""
    directions = evenly(20000)
    points = head.points(directions)
    normals = head.normals(points)
    others = np.array([*REGIONS.values(), (0.0, 0.0, -1.0)])
    inside = directions[np.argmax(normals @ others.T, axis=1) == list(REGIONS).index(region)]
    chosen = np.random.default_rng(0).choice(len(inside), count, replace=False)
    found: Floats = inside[chosen]
    return found


@pytest.mark.parametrize("name", HEADS)
def test_without_points_the_tre_is_that_of_the_landmarks(name: str) -> None:
    head = HEADS[name]
    given = head.session(1)
    found = surface_coverage(**(given | {"points_body_ref": NO_POINTS, "offsets": BOTH}))
    registration = given["registration"]
    (expected,) = predict_tre(registration @ head.landmarks, registration @ head.target, given["sigma"])
    assert found.tre == pytest.approx(expected, rel=1e-9)
    assert {each.region for each in found.regions} == set(REGIONS)
    assert all(each.points == 0 for each in found.regions)


@pytest.mark.parametrize("name", HEADS)
@pytest.mark.parametrize("offsets", [(), BOTH])
def test_coverage_predicts_what_the_refinement_states(name: str, offsets: tuple[OffsetPrior, ...]) -> None:
    given = HEADS[name].session(2, hair=0.002 if offsets else 0.0) | {"offsets": offsets}
    stated = refine_with_surface(**given).tre_after
    assert surface_coverage(**given).tre == pytest.approx(stated, rel=0.1)


@pytest.mark.parametrize("name", HEADS)
@pytest.mark.parametrize("region", REGIONS)
def test_points_that_are_touched_help_as_predicted(name: str, region: Region) -> None:
    head = HEADS[name]
    first = coverage(head, 3, count=40)
    (predicted,) = [each.tre for each in first.regions if each.region == region]
    given = head.session(3, count=40) | {"offsets": BOTH}
    rng = np.random.default_rng(7)
    more = head.touched(within(head, region, first.more), rng, 0.002, 0.0)
    given["points_body_ref"] = np.concatenate((given["points_body_ref"], more))
    then = surface_coverage(**given)
    assert then.tre == pytest.approx(predicted, rel=0.1)
    (before,) = [each.points for each in first.regions if each.region == region]
    (after,) = [each.points for each in then.regions if each.region == region]
    assert after - before >= first.more - 2  # noise turns a normal at the border of two regions


@pytest.mark.parametrize("region", ["front", "left"])
def test_a_region_that_was_touched_is_not_the_one_that_helps(region: Region) -> None:
    touched = PHANTOM.touched(within(PHANTOM, region, 60), np.random.default_rng(1), 0.002, 0.0)
    found = coverage(PHANTOM, 5, points_body_ref=touched)
    assert found.regions[0].region != region
    assert found.regions[0].tre < found.tre


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.integers(1, 50))
def test_more_points_never_raise_the_tre(seed: int, count: int, more: int) -> None:
    touched = PHANTOM.session(seed % 1000, count=60)["points_body_ref"][:count]
    found = coverage(PHANTOM, seed % 1000, points_body_ref=touched, more=more)
    twice = coverage(PHANTOM, seed % 1000, points_body_ref=touched, more=2 * more)
    later = {each.region: each.tre for each in twice.regions}
    assert all(later[each.region] <= each.tre <= found.tre for each in found.regions)
    assert [each.tre for each in found.regions] == sorted(each.tre for each in found.regions)


def test_advice_says_where_and_by_how_much() -> None:
    found = coverage(PHANTOM, 1, points_body_ref=NO_POINTS)
    best = found.regions[0]
    place = PLACES[best.region]
    assert found.advice == f"20 points {place}: {found.tre * 1000:.1f} → {best.tre * 1000:.1f} mm"


def test_a_sheet_has_only_the_regions_that_it_faces() -> None:
    sheet = np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0)])
    up = coverage(PHANTOM, 1, points_body_ref=NO_POINTS, vertices=sheet, faces=np.array([(0, 1, 2)]))
    assert [each.region for each in up.regions] == ["top"]
    down = coverage(PHANTOM, 1, points_body_ref=NO_POINTS, vertices=sheet, faces=np.array([(0, 2, 1)]))
    assert down.regions == ()
    assert down.advice == ""


def test_points_far_from_the_mesh_are_counted_all_the_same() -> None:
    """A wrong unit of the mesh is found by the refinement; here it must not take the memory of all pairs."""
    found = coverage(PHANTOM, 1, vertices=PHANTOM.vertices * 1000.0)
    assert sum(each.points for each in found.regions) <= 100
