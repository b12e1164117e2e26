"""The states of one branch with the ports of its arrows: each arrow is drawn once, and lanes do not overlap."""

from __future__ import annotations

from hypothesis import given

from pcmrs.authoring.chart._arrows import arrows
from pcmrs.authoring.chart._column import Lane, column
from pcmrs.authoring.chart._links import links
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints


def passed(lane: Lane, order: list[str]) -> set[int]:
    ends = [order.index(state) for state in (*lane.arrow.sources, lane.arrow.target)]
    return set(range(min(ends), max(ends) + 1))


@examples(25)
@given(blueprints())
def test_every_arrow_is_in_one_place(blueprint: Blueprint) -> None:
    for name, branch in blueprint.branches.items():
        made = column(name, branch, [])
        straight = [arrow for arrow, _ in made.straight.values()]
        placed = [*straight, *(arrow for arrow, _ in made.entries), *(lane.arrow for lane in made.lanes)]
        drawn = arrows(name, branch)
        assert sorted(map(repr, placed)) == sorted(repr(arrow) for arrow in drawn if not arrow.loops)
        assert {state for state, row in made.rows.items() if row.loops} == {a.target for a in drawn if a.loops}


@examples(25)
@given(blueprints())
def test_arrows_of_one_lane_pass_no_state_together(blueprint: Blueprint) -> None:
    for name, branch in blueprint.branches.items():
        taken: dict[int, set[int]] = {}
        for lane in column(name, branch, []).lanes:
            rows = passed(lane, list(branch.states))
            assert not rows & taken.get(lane.number, set())
            taken[lane.number] = taken.get(lane.number, set()) | rows


@examples(25)
@given(blueprints())
def test_every_end_of_a_line_has_its_own_port(blueprint: Blueprint) -> None:
    joined = [link for link in links(blueprint) if link.kind != "revocation"]
    for name, branch in blueprint.branches.items():
        made = column(name, branch, joined)
        left = [id(port) for row in made.rows.values() for port in row.left]
        right = [id(port) for row in made.rows.values() for port in row.right]
        assert len(set(left)) == len(left) == len(made.entries) + len(made.links)
        assert len(set(right)) == len(right) == sum(len(lane.tails) + 1 for lane in made.lanes)
        assert {place.branch for _, place in made.links} <= {name}


def test_steps_to_the_next_state_run_straight_and_others_beside() -> None:
    operations = {
        "on": OperationSpec(from_=["a"], to="b"),
        "over": OperationSpec(from_=["a"], to="c"),
        "back": OperationSpec(from_=["b"], to="a"),
        "anyhow": OperationSpec(from_=["*"], to="c"),
        "stay": OperationSpec(from_=["c"], to="c"),
    }
    made = column("x", BranchSpec(states=dict.fromkeys("abc", ""), operations=operations), [])
    assert {state: arrow.labels for state, (arrow, _) in made.straight.items()} == {"a": ("on",)}
    assert [arrow.labels for arrow, _ in made.entries] == [("anyhow",)]
    assert sorted(lane.arrow.labels for lane in made.lanes) == [("back",), ("over",)]
    assert made.rows["c"].loops == ["stay"]
