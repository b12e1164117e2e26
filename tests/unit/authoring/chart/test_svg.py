"""The SVG chart of a workflow: complete, well-formed, the same each time."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import svg
from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.authoring.chart import chart_reading as reading
from tests.unit.fsm.random_blueprints import blueprints


@examples(25)
@given(blueprints(), st.data())
def test_just_the_given_states_are_highlighted(blueprint: Blueprint, data: st.DataObject) -> None:
    chosen = data.draw(st.lists(st.sampled_from(list(blueprint.branches)), unique=True))
    current = {name: data.draw(st.sampled_from(list(blueprint.branches[name].states))) for name in chosen}
    assert reading.highlighted(reading.parse(svg(blueprint, current))) == set(current.items())


@examples(25)
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
    drawn = svg(shipped_blueprint("ratms"), {"robot": "1"})
    assert drawn == svg(shipped_blueprint("ratms"), {"robot": "1"})
    assert drawn != svg(shipped_blueprint("ratms"))
    assert re.findall(r"https?://[^\"]*", drawn) == ["http://www.w3.org/2000/svg"]
    assert not re.search(r"href|url\(|@import|<script|<style", drawn)


def test_the_chart_names_itself_for_those_who_do_not_see_it() -> None:
    root = reading.parse(svg(shipped_blueprint("ratms"), {"robot": "1"}))
    assert root.findtext(f"{reading.SVG}title") == "Robotic transcranial magnetic stimulation (ratms 1.4.0)"
    described = root.findtext(f"{reading.SVG}desc") or ""
    assert "digitization (level 2, refines registration): 0, 1" in described
    assert described.endswith("Highlighted: robot 1.")


def test_a_whole_procedure_has_every_kind_of_line() -> None:
    root = reading.parse(svg(shipped_blueprint("ratms")))
    drawn = [*reading.groups(root, "arrow"), *reading.groups(root, "link")]
    kinds = {word for group in drawn for word in group.attrib["class"].split()}
    assert kinds == {"arrow", "link", "transition", "failure", "signal", "call", "revocation"}
