"""Regions of a state chart become branches, nesting becomes levels."""

from __future__ import annotations

from tests.unit.authoring.exchange.importing.importable_scxml import importable


def test_nested_states_are_a_branch_of_the_next_level() -> None:
    blueprint = importable(
        """<state id="Off"><transition event="power.on" target="On"/></state>
        <state id="On" initial="warm">
          <transition event="power.off" target="Off"/>
          <state id="cold"><transition event="cut" target="Off"/></state>
          <state id="warm"><transition event="wait" target="cold"/></state>
        </state>""",
        name="Lamp",
    )
    assert {name: (spec.level, list(spec.states)) for name, spec in blueprint.branches.items()} == {
        "lamp": (1, ["off", "on"]),
        "on": (2, ["warm", "cold"]),
    }
    child = blueprint.branches["on"]
    assert child.parent is not None
    assert child.parent.compatible == {"warm": ["off", "on"], "cold": ["on"]}
    cut = blueprint.branches["lamp"].operations["cut"]
    assert (cut.from_, cut.to, cut.requires) == (["on"], "off", {"on": ["cold"]})


def test_parallel_regions_with_own_events_are_level_1_branches() -> None:
    blueprint = importable(
        """<parallel id="all">
          <state id="door"><state id="shut"><transition event="door.open" target="ajar"/></state>
            <state id="ajar"/></state>
          <state id="lamp"><state id="off"><transition event="lamp.switch" target="on"/></state>
            <state id="on"/></state>
        </parallel>"""
    )
    assert {name: spec.level for name, spec in blueprint.branches.items()} == {"door": 1, "lamp": 1}
    assert list(blueprint.branches["door"].operations) == ["open"]
