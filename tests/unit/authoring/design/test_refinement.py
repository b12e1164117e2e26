"""Refinements as the branch above sees them: begun, complete, and what would be left behind."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.authoring.design._grouping import UndesignableError
from pcmrs.authoring.design._refinement import emits_of, parent_of, refinements_of, resting_on
from tests.unit.authoring.design.step_tables import converted, step

INNER = {"branch": "inner", "steps": [step("p"), step("q", "p")]}
OUTER = {"branch": "outer", "steps": [step("r", refined_by=INNER), step("s")]}


def test_states_between_start_and_complete_have_begun() -> None:
    (group,), paths = converted(step("a", refined_by=INNER))
    (inner,) = refinements_of(group, paths)
    assert (inner.start, inner.partial, inner.complete) == ("00", ["10"], "11")
    (group,), paths = converted(step("a", refined_by={"branch": "inner", "steps": [step("p")]}))
    (single,) = refinements_of(group, paths)
    assert (single.partial, single.calm()) == ([], {})
    assert emits_of(single, group.order.steps[0]) == {"0": "undo_a", "1": "do_a"}
    assert emits_of(inner, group.order.steps[0]) == {"*": "undo_a", "11": "do_a"}


def test_nothing_may_have_begun_in_a_whole_subtree() -> None:
    (group,), paths = converted(step("a", refined_by=OUTER))
    (outer,) = refinements_of(group, paths)
    assert [each.name for each in outer.subtree()] == ["outer", "inner"]
    assert outer.calm() == {"outer": ["00", "11"], "inner": ["00", "11"]}


def test_a_refinement_fits_where_its_step_is_possible() -> None:
    """Complete where the step is achieved, begun where it is possible, the start wherever it is not achieved."""
    (group,), paths = converted(step("z"), step("a", "z", refined_by=INNER))
    (inner,) = refinements_of(group, paths)
    parent = parent_of(inner, group)
    assert (parent.branch, parent.start) == ("procedure", "10")
    assert parent.compatible == {"00": ["00", "10"], "11": ["11"], "*": ["10"]}


def test_a_deep_refinement_must_be_calm_when_its_step_opens() -> None:
    (group,), paths = converted(step("z"), step("a", "z", refined_by=OUTER), step("b", "z", refined_by=INNER_B))
    refinements = refinements_of(group, paths)
    assert resting_on(0, refinements, group.order) == {"outer": ["00", "11"], "inner": ["00", "11"]}
    assert resting_on(1, refinements, group.order) == {}
    signalled = resting_on(0, refinements, group.order, signalled=True)
    assert set(signalled) == {"outer", "inner", "inner_b"}


INNER_B: dict[str, Any] = {"branch": "inner_b", "steps": [step("t"), step("u", "t")]}


@pytest.mark.parametrize(
    ("points", "path"), [(0, "points"), (["p", "p"], "points.1"), (["done"], "points.0"), (2000, "points")]
)
def test_points_that_make_no_sequence_are_found_in_the_table(points: Any, path: str) -> None:
    (group,), paths = converted(step("a", steps=["work"], refined_by={"branch": "inner", "points": points}))
    with pytest.raises(UndesignableError) as refused:
        refinements_of(group, paths)
    assert refused.value.finding.code == "bad_sequence"
    assert ".".join(refused.value.finding.path) == f"steps.0.refined_by.{path}"
