"""Events of a state chart become operations."""

from __future__ import annotations

from tests.unit.authoring.exchange.importing.importable_scxml import importable


def test_a_common_event_moves_parallel_regions_together() -> None:
    blueprint = importable(
        """<parallel id="all">
          <state id="door"><state id="shut"><transition event="fire" target="ajar"/></state><state id="ajar"/></state>
          <state id="lamp"><state id="off"><transition event="fire" target="on"/></state><state id="on"/></state>
        </parallel>"""
    )
    fire = blueprint.branches["main"].operations["fire"]
    assert fire.sets == {"door": "ajar", "lamp": "on"}
    assert fire.requires == {"door": ["shut"], "lamp": ["off"]}
    assert [spec.operations["fire"].requires for name, spec in blueprint.branches.items() if name != "main"] == [
        {"main": ["all"], "lamp": ["on"]},
        {"main": ["all"], "door": ["ajar"]},
    ]


def test_an_inner_transition_comes_before_an_outer_one() -> None:
    blueprint = importable(
        """<state id="out"><transition event="e" target="end"/>
          <state id="in"><transition event="e" target="next"/></state><state id="next"/></state>
        <state id="end"/>"""
    )
    assert blueprint.branches["main"].operations["e"].requires == {"out": ["next"]}
    assert blueprint.branches["out"].operations["e"].from_ == ["in"]
