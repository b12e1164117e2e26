"""The SVG chart of random workflows: complete, well-formed, nothing on top of anything else, the same each time."""

from __future__ import annotations

import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import svg
from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.files.load import read_blueprint
from tests.support.ratms_oracle import BLUEPRINT
from tests.support.trials import examples
from tests.unit.fsm import chart_reading as reading
from tests.unit.fsm.random_blueprints import blueprints

charts = examples(25)


def ratms() -> Blueprint:
    blueprint, _ = read_blueprint(BLUEPRINT.read_bytes(), "ratms.toml")
    assert blueprint is not None
    return blueprint


def in_every_state(operation: OperationSpec, branch: BranchSpec) -> list[str]:
    return list(branch.states) if operation.from_ == ["*"] else operation.from_


@charts
@given(blueprints())
def test_states_and_branches_are_drawn_once_and_boxes_keep_apart(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    boxes = reading.states(root)
    assert set(boxes) == {(name, state) for name, branch in blueprint.branches.items() for state in branch.states}
    assert len(reading.groups(root, "state")) == len(boxes)
    assert not [pair for pair in itertools.combinations(boxes.items(), 2) if pair[0][1].meets(pair[1][1])]


@charts
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


@charts
@given(blueprints())
def test_captions_meet_neither_lines_nor_boxes_nor_each_other(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    captions = reading.captions(root)
    obstacles = [*itertools.chain(*reading.segments(root)), *reading.states(root).values()]
    assert not [(caption, other) for caption in captions for other in obstacles if caption.meets(other)]
    assert not [pair for pair in itertools.combinations(captions, 2) if pair[0].meets(pair[1])]


@charts
@given(blueprints())
def test_lines_cross_but_never_run_on_each_other(blueprint: Blueprint) -> None:
    lines = reading.segments(reading.parse(svg(blueprint)))
    for one, another in itertools.combinations(lines, 2):
        pieces = itertools.product(one, another)
        assert not [pair for pair in pieces if pair[0].lies == pair[1].lies and pair[0].meets(pair[1])]


@charts
@given(blueprints())
def test_every_ending_is_at_an_arrow_from_where_it_may_start(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    arrows = [(group.attrib, reading.texts(group)) for group in reading.groups(root, "arrow")]
    loops = {(g.attrib["data-branch"], g.attrib["data-state"]): reading.texts(g) for g in reading.groups(root, "state")}
    for name, branch in blueprint.branches.items():
        for called, operation in branch.operations.items():
            for outcome, ending in operation.endings.items():
                if operation.iio or ending.requires.get(name):
                    continue
                label = f"{called}: {outcome}" if operation.outcomes else called
                for source in in_every_state(operation, branch):
                    target = ending.to if isinstance(ending.to, str) else ending.to[source]
                    drawn = [
                        text
                        for given, text in arrows
                        if (given["data-branch"], given["data-target"]) == (name, target)
                        and ({source, "*"} & set(given["data-sources"].split()))
                        and "transition" in given["class"]
                    ]
                    kept = loops[name, target] if source == target else ""
                    assert any(label in text for text in (*drawn, kept))


@charts
@given(blueprints())
def test_rules_and_revocations_join_branches(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    found = {kind: reading.groups(root, kind) for kind in ("signal", "call", "revocation")}
    links = {kind: [group for group in found[kind] if "link" in group.attrib["class"]] for kind in found}
    nested = {name: branch for name, branch in blueprint.branches.items() if branch.parent is not None}
    signals = [(group.attrib["data-tails"].split(", "), reading.texts(group).split()) for group in links["signal"]]
    said = {(tail, words[0]) for tails, words in signals for tail in tails}
    assert said == {(f"{name} {state}", called) for name in nested for state, called in nested[name].emits.items()}
    assert len(links["call"]) == len(nested)
    revoked = {group.attrib["data-heads"] for group in links["revocation"]}
    assert revoked == {name for name, branch in blueprint.branches.items() if branch.revocations}


@charts
@given(blueprints(), st.data())
def test_just_the_given_states_are_highlighted(blueprint: Blueprint, data: st.DataObject) -> None:
    chosen = data.draw(st.lists(st.sampled_from(list(blueprint.branches)), unique=True))
    current = {name: data.draw(st.sampled_from(list(blueprint.branches[name].states))) for name in chosen}
    assert reading.highlighted(reading.parse(svg(blueprint, current))) == set(current.items())


@charts
@given(st.text(), st.text(), st.text(max_size=200))
def test_any_text_gives_well_formed_xml(title: str, branch_title: str, meaning: str) -> None:
    branch = BranchSpec(title=branch_title, states={"a": meaning, "b": title})
    written = svg(Blueprint(id="x", version="1", title=title, branches={"only": branch}))
    root = reading.parse(written)
    assert set(reading.states(root)) == {("only", "a"), ("only", "b")}
    written.encode()


def test_long_meaning_is_cut_with_ellipsis_and_whole_in_tooltip() -> None:
    meaning = "landmarks " * 60
    root = reading.parse(svg(Blueprint(id="x", version="1", branches={"b": BranchSpec(states={"a": meaning})})))
    (state,) = reading.groups(root, "state")
    assert "…" in reading.texts(state)
    assert state.findtext(f"{reading.SVG}title") == meaning.strip()


def test_the_same_chart_each_time_and_nothing_from_outside() -> None:
    drawn = svg(ratms(), {"robot": "1"})
    assert drawn == svg(ratms(), {"robot": "1"})
    assert drawn != svg(ratms())
    assert re.findall(r"https?://[^\"]*", drawn) == ["http://www.w3.org/2000/svg"]
    assert not re.search(r"href|url\(|@import|<script|<style", drawn)


def test_the_chart_names_itself_for_those_who_do_not_see_it() -> None:
    root = reading.parse(svg(ratms(), {"robot": "1"}))
    assert root.findtext(f"{reading.SVG}title") == "Robotic transcranial magnetic stimulation (ratms 1.3.0)"
    described = root.findtext(f"{reading.SVG}desc") or ""
    assert "digitization (level 2, refines registration): 0, 1" in described
    assert described.endswith("Highlighted: robot 1.")


@pytest.mark.parametrize(("current", "known"), [({"arm": "1"}, "registration"), ({"robot": "7"}, "0, 1")])
def test_an_unknown_state_is_refused_with_those_there_are(current: dict[str, str], known: str) -> None:
    with pytest.raises(ConfigurationError, match=known):
        svg(ratms(), current)


def test_a_sequence_of_a_thousand_states_is_drawn() -> None:
    names = [f"s{number}" for number in range(1000)]
    onwards = OperationSpec(from_=names[:-1], to=dict(itertools.pairwise(names)))
    branch = BranchSpec(states=dict.fromkeys(names, ""), operations={"go_on": onwards})
    root = reading.parse(svg(Blueprint(id="x", version="1", branches={"b": branch})))
    assert len(reading.states(root)) == 1000


def test_a_whole_procedure_has_every_kind_of_line() -> None:
    root = reading.parse(svg(ratms()))
    drawn = [*reading.groups(root, "arrow"), *reading.groups(root, "link")]
    kinds = {word for group in drawn for word in group.attrib["class"].split()}
    assert kinds == {"arrow", "link", "transition", "failure", "signal", "call", "revocation"}
