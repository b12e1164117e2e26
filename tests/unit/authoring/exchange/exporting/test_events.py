"""Events of an exported chart: those of the chart that was imported, if they are unmistakable."""

from __future__ import annotations

import re

from msgspec.structs import replace

from pcmrs.authoring.exchange.exporting.scxml import scxml
from tests.unit.authoring.exchange.importing.importable_scxml import importable


def test_the_export_of_an_import_has_the_events_of_the_chart() -> None:
    """Those of operations that are named otherwise, or would be taken for each other, are ``branch.operation``."""
    lamp = """<state id="Off"><transition event="Power.On" target="On"/></state>
        <state id="On"><transition event="cut" target="Off"/>
          <state id="cold"><transition event="warm-up" target="hot"/></state>
          <state id="hot"><transition event="cut" target="cold"/></state>
        </state>"""
    events = set(re.findall(r'event="([^"]*)"', scxml(importable(lamp, name="lamp"))))
    assert events == {"Power.On", "cut", "warm-up", "on.reinit"}
    events = set(re.findall(r'event="([^"]*)"', scxml(importable(lamp.replace("warm-up", "cut.not"), name="lamp"))))
    assert events == {"lamp.power_on", "lamp.cut", "on.cut_not", "on.cut", "on.reinit"}


def test_titles_that_do_not_exclude_each_other_are_no_events() -> None:
    blueprint = importable('<state id="a"><transition event="go" target="b"/></state><state id="b"/>', name="m")
    branch = blueprint.branches["m"]
    doubled = branch.operations | {"go_2": branch.operations["go"]}
    other = branch.operations | {"leave": branch.operations["go"]}
    for operations in (doubled, other):
        spec = replace(branch, operations=operations)
        assert 'event="m.go"' in scxml(replace(blueprint, branches={"m": spec}))
