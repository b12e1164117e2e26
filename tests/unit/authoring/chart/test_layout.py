"""Layout of random workflows: boxes, captions and lines keep apart."""

from __future__ import annotations

import itertools

from hypothesis import given

from pcmrs.authoring.chart import svg
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from tests.support.trials import examples
from tests.unit.authoring.chart import chart_reading as reading
from tests.unit.fsm.random_blueprints import blueprints


@examples(25)
@given(blueprints())
def test_states_and_branches_are_drawn_once_and_boxes_keep_apart(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    boxes = reading.states(root)
    assert set(boxes) == {(name, state) for name, branch in blueprint.branches.items() for state in branch.states}
    assert len(reading.groups(root, "state")) == len(boxes)
    assert not [pair for pair in itertools.combinations(boxes.items(), 2) if pair[0][1].meets(pair[1][1])]


@examples(25)
@given(blueprints())
def test_a_child_stands_inside_its_parent_and_others_apart(blueprint: Blueprint) -> None:
    frames = reading.frames(reading.parse(svg(blueprint)))
    for (name, frame), (other, another) in itertools.permutations(frames.items(), 2):
        ancestors = set(above(blueprint, name))
        if other in ancestors:
            assert another.left < frame.left < frame.right < another.right
            assert another.top < frame.top < frame.bottom < another.bottom
        elif name not in above(blueprint, other):
            assert not frame.meets(another)


def above(blueprint: Blueprint, name: str) -> list[str]:
    parent = blueprint.branches[name].parent
    return [] if parent is None else [parent.branch, *above(blueprint, parent.branch)]


@examples(25)
@given(blueprints())
def test_captions_meet_neither_lines_nor_boxes_nor_each_other(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    captions = reading.captions(root)
    obstacles = [*itertools.chain(*reading.segments(root)), *reading.states(root).values()]
    assert not [(caption, other) for caption in captions for other in obstacles if caption.meets(other)]
    assert not [pair for pair in itertools.combinations(captions, 2) if pair[0].meets(pair[1])]


@examples(25)
@given(blueprints())
def test_lines_cross_but_never_run_on_each_other(blueprint: Blueprint) -> None:
    lines = reading.segments(reading.parse(svg(blueprint)))
    for one, another in itertools.combinations(lines, 2):
        pieces = itertools.product(one, another)
        assert not [pair for pair in pieces if pair[0].lies == pair[1].lies and pair[0].meets(pair[1])]


def test_a_sequence_of_a_thousand_states_is_drawn() -> None:
    names = [f"s{number}" for number in range(1000)]
    onwards = OperationSpec(from_=names[:-1], to=dict(itertools.pairwise(names)))
    branch = BranchSpec(states=dict.fromkeys(names, ""), operations={"go_on": onwards})
    root = reading.parse(svg(Blueprint(id="x", version="1", branches={"b": branch})))
    assert len(reading.states(root)) == 1000
