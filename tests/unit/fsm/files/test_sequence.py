"""Ordered lists of items: the branch they are written out to does what a plain counter does."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import Blueprint, Closure, close
from pcmrs.fsm.files.sequence import MAX_ITEMS, SequenceError, expand
from tests.support.trials import examples

NAMES = st.lists(st.from_regex(r"[a-z0-9][a-z0-9_]{0,6}", fullmatch=True), min_size=1, max_size=5, unique=True).filter(
    lambda names: not any(name in ("done", "abandoned") or name.endswith("_stopped") for name in names)
)
COMMANDS = st.lists(
    st.sampled_from([*((name, "done") for name in ("perform", "repeat", "skip", "abandon")), ("perform", "failed")])
    | st.sampled_from([("perform", "unknown"), ("reinit", "done")]),
    max_size=15,
)


def with_sequence(sequence: dict[str, Any], **branch: Any) -> Blueprint:
    table = {"id": "grid", "version": "1", "branches": {"mapping": {"sequence": sequence, **branch}}}
    return msgspec.convert(table, Blueprint)


def counter(items: list[str], state: tuple[int, str], command: tuple[str, str]) -> tuple[int, str] | None:
    """The list stated naively: how many items are behind it, and how it stands; None for a rejection."""
    place, standing = state
    operation, ending = command
    if operation == "reinit":
        return (0, "open")
    if standing == "abandoned" or place == len(items):
        return None
    if operation == "perform":
        return None if standing != "open" else (place + 1, "open") if ending == "done" else (place, "stopped")
    if operation == "repeat":
        return (place, "open") if standing == "stopped" else None
    return (place + 1, "open") if operation == "skip" else (place, "abandoned")


def named(items: list[str], state: tuple[int, str]) -> str:
    place, standing = state
    if standing == "abandoned":
        return "abandoned"
    if place == len(items):
        return "done"
    return items[place] + ("_stopped" if standing == "stopped" else "")


@examples(60)
@given(items=NAMES, commands=COMMANDS)
def test_a_sequence_does_what_a_counter_does(items: list[str], commands: list[tuple[str, str]]) -> None:
    blueprint = expand(with_sequence({"items": items}))
    branch = blueprint.branches["mapping"]
    state = (0, "open")
    assert branch.start == items[0]
    for operation, ending in commands:
        after = counter(items, state, (operation, ending))
        assert branch.valid_in(operation, named(items, state)) == (after is not None)
        if after is None:
            continue
        closure = close(blueprint, {"mapping": named(items, state)}, "mapping", operation)
        assert isinstance(closure, Closure)
        change = {"failed": closure.failure, "unknown": closure.unknown}.get(ending, closure.outcomes["done"])
        assert change is not None
        assert change.states == {"mapping": named(items, after)}
        state = after


def test_before_is_the_first_state_and_reinit_leads_to_it() -> None:
    """Nothing but the planning operation and reinit can be done in it."""
    plan = {"from": ["*"], "to": "a"}
    blueprint = expand(with_sequence({"items": ["a", "b"], "before": "unplanned"}, operations={"plan": plan}))
    branch = blueprint.branches["mapping"]
    assert branch.start == "unplanned"
    able = [name for name in branch.operations if branch.valid_in(name, "unplanned")]
    assert sorted(able) == ["plan", "reinit"]
    assert branch.operations["reinit"].to == "unplanned"
    without = expand(with_sequence({"items": ["a", "b"]}, operations={"plan": plan})).branches["mapping"]
    assert list(branch.states) == ["unplanned", *without.states]
    same = ("perform", "skip", "repeat", "abandon")
    assert [branch.operations[name] for name in same] == [without.operations[name] for name in same]


def test_states_are_in_order_and_readable() -> None:
    branch = expand(with_sequence({"count": 2, "item": "spot"})).branches["mapping"]
    assert branch.sequence is None
    assert branch.states == {
        "spot_1": "spot 1 is next",
        "spot_1_stopped": "spot 1 was stopped",
        "spot_2": "spot 2 is next",
        "spot_2_stopped": "spot 2 was stopped",
        "done": "all performed or left out",
        "abandoned": "given up",
    }
    assert branch.rio == "reinit"


def test_given_keys_are_merged_and_operations_of_the_branch_stay() -> None:
    perform = {"steps": ["stimulate"], "roles": ["operator"], "title": "Stimulate"}
    own = {"skip": {"from": ["a"], "to": "done"}, "look": {"from": ["*"], "to": "a"}}
    branch = expand(with_sequence({"items": ["a", "b"], "perform": perform}, operations=own)).branches["mapping"]
    made = branch.operations["perform"]
    assert (made.steps, made.roles, made.title) == (["stimulate"], ["operator"], "Stimulate")
    assert made.to == {"a": "b", "b": "done"}
    assert branch.operations["skip"].to == "done"
    assert branch.operations["look"].to == "a"


def test_a_rio_under_another_name_is_the_only_one() -> None:
    own = {"restart": {"from": ["*"], "to": "a", "rio": True}}
    branch = expand(with_sequence({"items": ["a"]}, operations=own)).branches["mapping"]
    assert [name for name, operation in branch.operations.items() if operation.rio] == ["restart"]


def test_the_star_stands_for_all_states_not_named() -> None:
    parent = {"branch": "robot", "start": "1", "compatible": {"a": ["0", "1"], "*": ["1"]}}
    emits = {"done": "finished", "*": "moved"}
    branch = expand(with_sequence({"items": ["a", "b"]}, parent=parent, emits=emits)).branches["mapping"]
    assert branch.parent is not None
    assert branch.parent.compatible == {state: ["0", "1"] if state == "a" else ["1"] for state in branch.states}
    assert branch.emits == {state: "finished" if state == "done" else "moved" for state in branch.states}


def test_expanding_twice_changes_nothing() -> None:
    once = expand(with_sequence({"count": 3}, emits={"*": "moved"}))
    assert expand(once) == once


@pytest.mark.parametrize(
    ("sequence", "path", "word"),
    [
        ({}, "", "either"),
        ({"count": 2, "items": ["a"]}, "", "either"),
        ({"count": 0}, "count", "1 to 1000"),
        ({"count": MAX_ITEMS + 1}, "count", "1001"),
        ({"count": 3, "item": "Point"}, "item", "Point_3"),
        ({"count": 100, "item": "a" * 21}, "item", "24"),
        ({"items": ["a", "b", "a"]}, "items.2", "twice"),
        ({"items": ["a", "b_stopped"]}, "items.1", "b_stopped"),
        ({"items": ["done"]}, "items.0", "done"),
        ({"items": ["x-y"]}, "items.0", "x-y"),
        ({"items": [f"p{i}" for i in range(MAX_ITEMS + 1)]}, "items", "1001"),
        ({"items": ["a", "b"], "before": "b"}, "before", "twice"),
        ({"items": ["a"], "before": "done"}, "before", "done"),
        ({"items": ["a"], "before": "Not yet"}, "before", "Not yet"),
        ({"items": ["a"], "perform": {"to": "b"}}, "perform.to", "made"),
        ({"items": ["a"], "skip": {"from": ["b"]}}, "skip.from", "made"),
        ({"items": ["a"], "perform": {"speed": 3}}, "perform", "speed"),
        ({"items": ["a"], "repeat": {"steps": "x"}}, "repeat", "array"),
    ],
)
def test_invalid_sequence_is_refused_with_its_place(sequence: dict[str, Any], path: str, word: str) -> None:
    with pytest.raises(SequenceError) as raised:
        expand(with_sequence(sequence))
    assert raised.value.path == ("branches", "mapping", "sequence", *filter(None, path.split(".")))
    assert word in raised.value.text


def test_states_beside_a_sequence_are_refused() -> None:
    with pytest.raises(SequenceError) as raised:
        expand(with_sequence({"count": 1}, states={"a": "first"}))
    assert raised.value.path == ("branches", "mapping", "states")


def test_keys_for_an_operation_that_the_branch_has_are_refused() -> None:
    own = {"skip": {"from": ["*"], "to": "done"}}
    with pytest.raises(SequenceError, match="no effect"):
        expand(with_sequence({"items": ["a"], "skip": {"roles": ["x"]}}, operations=own))


def test_many_long_sequences_are_refused_before_memory_is_full() -> None:
    branches = {f"b{i}": {"sequence": {"count": MAX_ITEMS}} for i in range(11)}
    with pytest.raises(SequenceError, match="11000 items"):
        expand(msgspec.convert({"id": "x", "version": "1", "branches": branches}, Blueprint))
