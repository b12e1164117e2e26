"""SCXML as blueprints: an export of an import behaves as the document does."""

from __future__ import annotations

import re
from random import Random

import pytest

from pcmrs.authoring.exchange.exporting._events import commands
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.rules import check_rules
from tests.unit.authoring.exchange.importing.importable_scxml import importable
from tests.unit.authoring.exchange.random_charts import EVENTS, as_scxml, random_chart
from tests.unit.authoring.exchange.scxml_peer import Peer


def test_an_invoke_is_not_supported_where_it_is() -> None:
    document = '<scxml xmlns="http://www.w3.org/2005/07/scxml">\n<state id="a">\n<invoke src="x"/></state></scxml>'
    _, findings = from_scxml(document.encode())
    assert [(finding.code, finding.line) for finding in findings] == [("not_supported", 3)]


def send(peer: Peer, blueprint: Blueprint, event: str) -> None:
    """An event of the original: the operations with its title, until one does something."""
    before = peer.active()
    for command in commands(blueprint):
        title = blueprint.branches[command.branch].operations[command.operation].title
        if title == event and peer.active() == before:
            peer.send(command.event)


def side_by_side(document: str, rng: Random, length: int = 30) -> int | None:
    """Lets both react to the same events; returns how often they moved, None where the import has findings."""
    blueprint, findings = from_scxml(document.encode())
    if blueprint is None:
        assert findings
        return None
    assert not findings
    assert list(check_rules(blueprint)) == []
    states = {state for spec in blueprint.branches.values() for state in spec.states}
    original, again = Peer(document), Peer(scxml(blueprint))
    named = {name for events in re.findall(r'event="([^"]*)"', document) for name in events.split()}
    alphabet = [event for event in EVENTS if event in named] or ["nothing"]
    moved = 0
    for number in range(length):
        here, there = original.active() & states, {i.partition(".")[2] for i in again.active() if "." in i}
        assert there == here, (number, document, blueprint_toml(blueprint))
        event = rng.choice(alphabet)
        original.send(event)
        send(again, blueprint, event)
        moved += original.active() & states != here
    return moved


def again_side_by_side(document: str, rng: Random, length: int = 30) -> int | None:
    """Lets an import and the import of its export react alike; returns how often, None where there is no import."""
    first, _ = from_scxml(document.encode())
    if first is None:
        return None
    second, findings = from_scxml(scxml(first).encode())
    assert second is not None, (findings, document, scxml(first))
    assert list(check_rules(second)) == []
    one, other = Peer(scxml(first)), Peer(scxml(second))
    events = [command.event for command in commands(first)] or ["nothing"]
    states = {state for spec in second.branches.values() for state in spec.states}
    moved = 0
    for _ in range(length):
        here, there = ({i.partition(".")[2] for i in peer.active() if "." in i} for peer in (one, other))
        assert here & states == there & here, (document, scxml(first), scxml(second))
        event, before = rng.choice(events), one.active()
        one.send(event)
        send(other, second, event)
        moved += one.active() != before
    return moved


@pytest.mark.nightly
def test_an_export_is_imported_again() -> None:
    moved = [again_side_by_side(as_scxml(random_chart(Random(seed))), Random(seed)) for seed in range(150)]
    assert sum(count is not None and count > 3 for count in moved) > len(moved) / 8


def walk(seeds: range) -> None:
    results = [side_by_side(as_scxml(random_chart(Random(seed))), Random(seed)) for seed in seeds]
    moved = [count for count in results if count is not None]
    assert len(moved) > len(seeds) / 2, "most charts must be importable"
    assert sum(count > 3 for count in moved) > len(seeds) / 8


def test_import_then_export_is_the_identity_on_behaviour() -> None:
    walk(range(100))


CORNERS = {
    "a transition from a region into itself leaves all regions": """<parallel id="p">
      <state id="s1" initial="s2"><transition event="e0" target="s3"/>
        <state id="s2"><transition event="e1" target="s3"/></state><state id="s3"/></state>
      <state id="s4"><state id="s5"><transition event="e2" target="s6"/></state><state id="s6"/></state>
    </parallel>""",
    "unless it is internal": """<parallel id="p">
      <state id="s1" initial="s2"><transition event="e0" target="s3" type="internal"/>
        <state id="s2"><transition event="e1" target="s3"/></state>
        <state id="s3"><transition event="e1" target="s2"/></state></state>
      <state id="s4"><state id="s5"><transition event="e2" target="s6"/></state>
        <state id="s6"><transition event="e2" target="s5"/></state></state>
    </parallel>""",
    "several targets enter several regions": """<state id="s0"><transition event="e0" target="s3 s6"/></state>
    <parallel id="p"><transition event="e1" target="s0"/>
      <state id="s1"><state id="s2"/><state id="s3"><transition event="e2" target="s2"/></state></state>
      <state id="s4"><state id="s5"/><state id="s6"><transition event="e3" target="s5"/></state></state>
    </parallel>""",
    "what is inside an initial state begins anew": """<state id="s0"><transition event="e0" target="s1"/></state>
    <state id="s1"><transition event="e1" target="s0"/>
      <state id="s2"><state id="s3"><transition event="e2" target="s4"/></state><state id="s4"/></state>
      <state id="s5"/></state>""",
    "what is inside a state that is entered from further out begins anew, also where the state is active": """
    <parallel id="p">
      <state id="s1" initial="s2"><transition event="e0" target="s3"/>
        <state id="s2"/>
        <state id="s3"><state id="s5"><transition event="e1" target="s6"/></state><state id="s6"/></state></state>
      <state id="s4"><state id="s7"><transition event="e2" target="s8"/></state><state id="s8"/></state>
    </parallel>""",
    "a transition without target uses the event up": """<state id="s0"><transition event="e0" target="s3"/>
      <state id="s1"><transition event="e0"/><transition event="e1" target="s2"/></state>
      <state id="s2"><transition event="e1" target="s1"/></state></state>
    <state id="s3"><transition event="e2" target="s0"/></state>""",
}


@pytest.mark.parametrize("name", CORNERS)
def test_corners(name: str) -> None:
    moved = [side_by_side(f"<scxml>{CORNERS[name]}</scxml>", Random(seed)) for seed in range(5)]
    assert all(count is not None for count in moved)
    assert any(moved)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_import_then_export_of_many() -> None:
    walk(range(1_000, 6_000))


UNSUPPORTED = """<?xml version="1.0"?>
<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:tool="urn:a-tool" version="1.0" initial="a">
  <tool:layout x="1"/>
  <datamodel><data id="n" expr="0"/></datamodel>
  <script>n = 1</script>
  <state id="a" tool:x="2">
    <onentry><log expr="n"/></onentry>
    <onexit/>
    <invoke type="x"/>
    <history id="h"/>
    <transition event="go" cond="n == 0" target="b"/>
    <transition target="b"/>
    <transition event="*" target="b"/>
    <transition event="done.state.a" target="b"/>
    <transition event="go"><send event="x"/></transition>
  </state>
  <final id="b">
    <transition event="go" target="a"/>
  </final>
</scxml>
"""


def test_unsupported_scxml_is_named_with_line_and_column() -> None:
    blueprint, findings = from_scxml(UNSUPPORTED.encode(), "chart.scxml")
    assert blueprint is None
    assert {f.code for f in findings} == {"not_supported"}
    assert {f.file for f in findings} == {"chart.scxml"}
    places = [(f.line, f.column) for f in findings]
    assert places == [
        (4, 3), (5, 3), (7, 14), (9, 5), (10, 5), (11, 5), (12, 5), (13, 5), (14, 5), (15, 28), (17, 3),
    ]  # fmt: skip


def test_an_export_is_read_under_its_own_names() -> None:
    one = importable('<state id="a"><transition event="go" target="b"/></state><state id="b"/>', name="solo")
    again, findings = from_scxml(scxml(one).encode())
    assert not findings
    assert again is not None
    assert (again.id, list(again.branches), list(again.branches["solo"].states)) == ("solo", ["solo"], ["a", "b"])
    assert again.branches["solo"].operations["go"].from_ == ["a"]
