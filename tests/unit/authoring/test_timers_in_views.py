"""Every view of a workflow shows its timers, and SCXML that sends delayed events is read as timers again."""

from __future__ import annotations

from xml.etree import ElementTree

import msgspec
import pytest

from pcmrs.authoring.chart import dot, mermaid, svg
from pcmrs.authoring.difference import compare
from pcmrs.authoring.exchange import SCXML_NAMESPACE
from pcmrs.authoring.exchange.exporting.promela import promela
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.authoring.exchange.exporting.table import table
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import parse_blueprint
from pcmrs.fsm.blueprint import Blueprint, TimerSpec
from pcmrs.fsm.classes import source_of
from pcmrs.fsm.files.dump import blueprint_toml
from tests.unit.authoring.exchange.scxml_peer import Peer
from tests.unit.fsm.timed_workflow import TIMED, timed_blueprint

NAMESPACE = {"": SCXML_NAMESPACE}


def test_every_view_shows_them() -> None:
    for drawn in (svg(timed_blueprint()), dot(timed_blueprint())):
        assert drawn.count("after 600 s / left_alone") == 1
        assert drawn.count("after rest_s / rested") == 1
    assert "note right of tool_IS_placed : after 600 s / left_alone" in mermaid(timed_blueprint())
    assert "# after 60 s / reminded, repeated" in source_of(timed_blueprint())
    (row,) = (line for line in table(timed_blueprint()).splitlines() if "timer idle" in line)
    assert row == (
        "| tool | timer idle | placed |  |  |  | after 600 s | left_alone; restarted by tool.nudge, pulse.give |"
    )


def test_promela_has_their_events_as_those_of_the_environment() -> None:
    lines = promela(timed_blueprint()).splitlines()
    (way,) = (line for line in lines if "tool.left_alone" in line)
    assert way.endswith("/* tool.left_alone, environment: timer idle after 600 s */")
    assert "AT_tool = tool_IS_held" in way


def test_scxml_sends_delayed_events_and_cancels_them() -> None:
    root = ElementTree.fromstring(scxml(timed_blueprint()))
    placed = next(each for each in root.iter(f"{{{SCXML_NAMESPACE}}}state") if each.get("id") == "tool.placed")
    (send,) = placed.findall("onentry/send", NAMESPACE)
    assert send.attrib == {"id": "tool.idle", "event": "tool.left_alone", "delayexpr": "'600s'"}
    assert [each.get("sendid") for each in placed.findall("onexit/cancel", NAMESPACE)] == ["tool.idle"]
    nudges = [each for each in placed.findall("transition", NAMESPACE) if each.get("event") == "tool.nudge"]
    assert [[child.tag.partition("}")[2] for child in each] for each in nudges] == [["cancel", "send"]]
    ready = next(each for each in root.iter(f"{{{SCXML_NAMESPACE}}}state") if each.get("id") == "pulse.ready")
    assert ready.find("transition/if", NAMESPACE).get("cond") == "In('tool.placed')"  # type: ignore[union-attr]


SIMPLE = """
id = "simple"
version = "1.0.0"

[branches.tool]
states = { away = "away", placed = "placed", held = "held" }

[branches.tool.timers]
idle = { states = ["placed"], after_s = 90.5, posts = "left_alone", restarted_by = ["tool.nudge", "session.note"] }

[branches.tool.operations.place]
title = "place"
from = ["away", "held"]
to = "placed"

[branches.tool.operations.nudge]
title = "nudge"
from = ["placed"]
to = "placed"

[branches.tool.operations.left_alone]
title = "left_alone"
from = ["placed"]
to = "held"
event = true

[branches.tool.operations.withdraw]
title = "withdraw"
from = ["placed", "held"]
to = "away"

[branches.session]
states = { closed = "closed", open = "open" }

[branches.session.timers]
remind = { states = ["open"], after_s = 60, posts = "reminded", repeat = true }

[branches.session.operations.begin]
title = "begin"
from = ["closed"]
to = "open"

[branches.session.operations.note]
title = "note"
from = ["open"]
to = "open"

[branches.session.operations.reminded]
title = "reminded"
from = ["open"]
to = "open"
event = true

[branches.session.operations.end]
title = "end"
from = ["open"]
to = "closed"
"""


def timers(blueprint: Blueprint) -> dict[str, TimerSpec]:
    return {f"{name}.{key}": each for name, spec in blueprint.branches.items() for key, each in spec.timers.items()}


def test_scxml_with_timers_is_read_again() -> None:
    once = parse_blueprint(SIMPLE.encode())
    again, findings = from_scxml(scxml(once).encode())
    assert again is not None, findings
    assert timers(again) == timers(once)
    assert again.branches["tool"].operations["left_alone"].event
    assert not again.branches["tool"].operations["place"].event
    assert timers(parse_blueprint(blueprint_toml(again).encode())) == timers(once)


def test_a_processor_of_scxml_lets_the_timer_expire() -> None:
    """It returns from an event when no other is to come, the delayed ones included."""
    repeating = 'remind = { states = ["open"], after_s = 60, posts = "reminded", repeat = true }'
    once = SIMPLE.replace(repeating, "").replace("after_s = 90.5", "after_s = 0.1")
    peer = Peer(scxml(parse_blueprint(once.encode())))
    peer.send("begin")
    assert "tool.away" in peer.active()
    peer.send("place")
    assert "tool.held" in peer.active()


def test_mermaid_with_timers_is_read_without() -> None:
    again, findings = from_mermaid(mermaid(parse_blueprint(SIMPLE.encode())).encode())
    assert again is not None, findings
    assert timers(again) == {}


CHART = """<scxml xmlns="http://www.w3.org/2005/07/scxml">
<state id="a"><transition event="go" target="b"/></state>
<state id="b">
  <onentry><send id="w" event="back" delay="1500ms"/></onentry>
  <onexit><cancel sendid="w"/></onexit>
  <transition event="back" target="a"/>
</state>
</scxml>"""


def test_a_delay_of_another_chart_is_read() -> None:
    blueprint, findings = from_scxml(CHART.encode())
    assert blueprint is not None, findings
    assert timers(blueprint) == {"main.w": TimerSpec(states=["b"], after_s=1.5, posts="back")}


UNSUPPORTED = {
    # what is replaced, by what, a part of the finding
    "never cancelled": ('<onexit><cancel sendid="w"/></onexit>', "", "must be cancelled"),
    "another cancelled": ('sendid="w"', 'sendid="v"', "must be cancelled"),
    "sent elsewhere": ('delay="1500ms"', 'delay="1500ms" target="other"', "&lt;send"),
    "no constant time": ('delay="1500ms"', 'delayexpr="now + 5"', "constant delay"),
    "without id": ('id="w" event="back"', 'event="back"', "constant delay"),
    "no effect": ('event="back" delay', 'event="gone" delay', "not exactly one effect"),
    "other content": ("<onentry>", "<onentry><log/>", "<log> is not supported"),
    "content of a transition": (
        '<transition event="back" target="a"/>',
        '<transition event="back" target="a"><cancel sendid="w"/></transition>',
        "must be followed",
    ),
    "sent again elsewhere": (
        '<transition event="go" target="b"/>',
        '<transition event="go" target="b"><cancel sendid="w"/><send id="w" event="back" delay="1500ms"/></transition>',
        "sent again only while",
    ),
}


@pytest.mark.parametrize("change", list(UNSUPPORTED))
def test_a_delayed_event_that_is_no_timer_is_a_finding(change: str) -> None:
    old, new, text = UNSUPPORTED[change]
    assert old in CHART
    blueprint, findings = from_scxml(CHART.replace(old, new, 1).encode())
    assert blueprint is None
    assert any(text.replace("&lt;", "<") in finding.text for finding in findings), findings
    assert {finding.code for finding in findings} == {"not_supported"}


def test_a_changed_timer_is_a_difference() -> None:
    slower = parse_blueprint(TIMED.replace("after_s = 600", "after_s = 900").encode())
    (found,) = compare(timed_blueprint(), slower)
    assert (found.kind, found.subject, found.old, found.new) == ("changed", "tool.timer idle", "600.0", "900.0")
    bare = msgspec.structs.replace(timed_blueprint().branches["session"], timers={})
    without = msgspec.structs.replace(timed_blueprint(), branches=timed_blueprint().branches | {"session": bare})
    assert [each.kind for each in compare(timed_blueprint(), without)] == ["removed"]
