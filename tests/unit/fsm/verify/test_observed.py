"""States that note when they are looked at."""

from __future__ import annotations

from pcmrs.fsm.verify._observed import DependencyObserver
from tests.unit.fsm.large_blueprints import free

STATES = {"b0": "s0", "b1": "s1", "b2": "s0", "b3": "s1", "b4": "s1"}


def test_states_are_noted_in_the_order_of_looking() -> None:
    states, seen = DependencyObserver(free(5, 2)).observe(STATES, "b4")
    assert seen == {"b4": "s1"}
    assert states["b3"] == "s1"
    assert states["b1"] != "s0"
    assert {"s0": 1}[states["b0"]] == 1
    assert list(seen.items()) == [("b4", "s1"), ("b3", "s1"), ("b1", "s1"), ("b0", "s0")]
    assert f"{states['b2']}" == "s0"
    assert "b2" not in seen


def test_each_observation_begins_with_nothing_seen() -> None:
    observer = DependencyObserver(free(5, 2))
    states, before = observer.observe(STATES, "b0")
    assert states["b1"] in ["s0", "s1"]
    _, seen = observer.observe({**STATES, "b2": "s1"}, "b2")
    assert (list(before), seen, observer.seen) == (["b0", "b1"], {"b2": "s1"}, {"b2": "s1"})
