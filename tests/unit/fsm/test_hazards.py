"""Operations that reach the patient: barred by Stop, confirmed, done once, and always with a way back."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.fsm import Blueprint, Closure, Denial, Engine, examine, parse_blueprint
from pcmrs.fsm.files.dump import blueprint_toml

NEEDLE = """
id = "needle"
version = "1"

[branches.needle]
states = { out = "outside", inside = "inside", sampled = "sample taken", done = "outside again" }

[branches.needle.operations]
insert = { from = ["out"], to = "inside", affects_patient = true, CONFIRM }
sample = { from = ["inside"], to = "sampled", affects_patient = true, irreversible = true }
withdraw = { from = ["inside", "sampled"], to = { inside = "out", sampled = "done" } }
again = { from = ["done"], to = "out", ALLOWS }

[branches.safety]
states = { watched = "Stop is heeded" }
operations.acknowledge = { from = ["*"], to = "watched", unlatches = true }
"""
ALLOWED = NEEDLE.replace("ALLOWS", 'allows_again = ["sample"]')
PLAIN = ALLOWED.replace(", CONFIRM", "")
CONFIRMED = ALLOWED.replace("CONFIRM", "confirm = true")


def found(text: str) -> list[tuple[str, tuple[str, ...] | None]]:
    return [(finding.code, finding.commands) for finding in examine(text.encode()).findings]


def test_irreversible_operation_needs_one_that_allows_it_again() -> None:
    unmarked = PLAIN.replace('allows_again = ["sample"]', "title = 'again'")
    around = ("needle.insert", "needle.sample", "needle.withdraw", "needle.again", "needle.insert")
    assert found(unmarked) == [("repeatable", around)]
    assert found(PLAIN) == []


FAULTS: dict[str, tuple[str, str]] = {
    "after a failure nobody knows how far it got": ("irreversible = true", 'irreversible = true, steps = ["cut"]'),
    "a device cannot do it": ("irreversible = true", "irreversible = true, event = true"),
    "what is allowed again must be irreversible": ('allows_again = ["sample"]', 'allows_again = ["insert"]'),
    "nothing irreversible allows it": ("irreversible = true", 'irreversible = true, allows_again = ["sample"]'),
    "no event is confirmed": ('allows_again = ["sample"]', "event = true, confirm = true"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_contradictory_hazard_marks_are_refused(fault: str) -> None:
    old, new = FAULTS[fault]
    codes = {code for code, _ in found(PLAIN.replace(old, new))}
    assert codes == {"bad_operation"}


def test_operation_to_allow_again_must_exist() -> None:
    assert found(PLAIN.replace('["sample"]', '["stitch"]')) == [("unknown_operation", None)]


def engine() -> Engine:
    return Engine(parse_blueprint(CONFIRMED.encode()))


def refused(engine: Engine, branch: str, operation: str) -> str:
    answer = engine.ask(branch, operation)
    assert isinstance(answer, Denial)
    return answer.code


def told(engine: Engine, branch: str, operation: str) -> str:
    answer = engine.ask(branch, operation)
    assert isinstance(answer, Denial)
    return answer.text


def test_each_confirmation_counts_once() -> None:
    cell = engine()
    assert refused(cell, "needle", "insert") == "not_confirmed"
    assert "Ask for insert_confirmation.confirm_insert first." in told(cell, "needle", "insert")
    cell.perform("insert_confirmation", "confirm_insert")
    cell.perform("needle", "insert")
    assert cell.joint()["insert_confirmation"] == "open"
    cell.perform("needle", "withdraw")
    assert refused(cell, "needle", "insert") == "not_confirmed"


@pytest.mark.parametrize(("branch", "operation"), [("safety", "acknowledge"), ("insert_confirmation", "take_back")])
def test_confirmation_can_be_taken_back_and_ends_with_a_stop(branch: str, operation: str) -> None:
    cell = engine()
    cell.perform("insert_confirmation", "confirm_insert")
    assert isinstance(cell.ask("needle", "insert"), Closure)
    cell.perform(branch, operation)
    assert refused(cell, "needle", "insert") == "not_confirmed"


def test_only_possible_operations_are_confirmed_if_not_latched() -> None:
    cell = engine()
    cell.place({"needle": "inside"})
    assert refused(cell, "insert_confirmation", "confirm_insert") == "requirement_not_met"
    confirm = cell.blueprint.branches["insert_confirmation"].operations["confirm_insert"]
    assert confirm.blocked_when_latched


def test_an_expanded_confirmation_is_written_and_read_as_it_is() -> None:
    blueprint: Blueprint = parse_blueprint(CONFIRMED.encode())
    again: Any = parse_blueprint(blueprint_toml(blueprint).encode())
    assert (again.branches, again.hash) == (blueprint.branches, blueprint.hash)
