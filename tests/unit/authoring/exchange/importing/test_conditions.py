"""Conditions on active states, and events that depend on too many of them."""

from __future__ import annotations

import pytest

from pcmrs.authoring.exchange.importing.scxml import from_scxml
from tests.unit.authoring.exchange.importing.importable_scxml import importable
from tests.unit.authoring.exchange.random_charts import flat


def test_many_regions_that_react_together_are_refused() -> None:
    """9 states in each of 12 regions would be 9^12 situations."""
    region = '<state id="{0}">' + flat(9, "e", "{{0}}.s0").replace('id="', 'id="{0}.') + "</state>"
    regions = "".join(region.replace("{{0}}", "{0}").format(f"r{i}") for i in range(12))
    _, findings = from_scxml(f'<scxml><parallel id="p">{regions}</parallel></scxml>'.encode(), "file")
    assert [finding.code for finding in findings] == ["too_large"]


def test_conditions_on_many_regions_are_refused() -> None:
    """Each of 300 events depends on 2^10 situations: more than can be looked at without a wait."""
    regions = "".join(f'<state id="r{i}">{flat(2, f"r{i}.e{{}}", f"r{i}.s{{}}")}</state>' for i in range(10))
    regions = regions.replace('<state id="s', '<state id="sN')
    for i in range(10):
        regions = regions.replace('id="sN', f'id="r{i}.s', 2)
    condition = " &amp;&amp; ".join(f"In('r{i}.s1')" for i in range(10))
    edges = "".join(f'<transition event="go{i}" cond="{condition}" target="y"/>' for i in range(300))
    own = f'<state id="own"><state id="x">{edges}</state><state id="y"/></state>'
    _, findings = from_scxml(f'<scxml><parallel id="p">{regions}{own}</parallel></scxml>'.encode(), "file")
    assert {finding.code for finding in findings} == {"too_large"}


DOORS = """<parallel id="all">
  <state id="door"><state id="shut"><transition event="open" cond="COND" target="ajar"/></state>
    <state id="ajar"/></state>
  <state id="lamp"><state id="off"><transition event="switch" target="on"/></state>
    <state id="on"><transition event="switch" target="dim"/></state><state id="dim"/></state>
</parallel>"""


@pytest.mark.parametrize(
    ("condition", "states"),
    [
        ("In('on')", ["on"]),
        ("In(&quot;on&quot;) &amp;&amp; In('shut')", ["on"]),
        ("In('off') || In('dim')", ["off", "dim"]),
        ("(In('off') || In('dim')) &amp;&amp; (In('dim') || In('on')) &amp;&amp; In('lamp')", ["dim"]),
    ],
)
def test_conditions_on_active_states_are_requirements(condition: str, states: list[str]) -> None:
    blueprint = importable(DOORS.replace("COND", condition))
    assert blueprint.branches["door"].operations["open"].requires == {"lamp": states}


@pytest.mark.parametrize(
    ("condition", "code"),
    [
        ("", "not_supported"),
        ("!In('on')", "not_supported"),
        ("In('on') || In('off') &amp;&amp; In('shut')", "not_supported"),
        ("In('on') &amp;&amp; x &gt; 1", "not_supported"),
        ("In('nowhere')", "unknown_state"),
    ],
)
def test_other_conditions_are_refused(condition: str, code: str) -> None:
    _, findings = from_scxml(f"<scxml>{DOORS.replace('COND', condition)}</scxml>".encode())
    assert [(finding.code, finding.line) for finding in findings] == [(code, 2)]
