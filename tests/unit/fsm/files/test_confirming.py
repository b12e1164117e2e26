"""Operations that are confirmed: each time before they are accepted, and never across a Stop."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.fsm import Blueprint, Closure, Denial, Engine, guide_for, parse_blueprint
from pcmrs.fsm.files.dump import blueprint_toml
from tests.unit.fsm.needle_workflow import CONFIRMED


def engine() -> Engine:
    return Engine(parse_blueprint(CONFIRMED.encode()))


def refused(engine: Engine, branch: str, operation: str) -> str:
    answer = engine.ask(branch, operation)
    assert isinstance(answer, Denial)
    return answer.code


def test_each_confirmation_counts_once() -> None:
    cell = engine()
    assert refused(cell, "needle", "insert") == "not_confirmed"
    way = guide_for(cell.blueprint).to_operation(cell.joint(), "needle.insert")
    assert way.path == ("insert_confirmation.confirm_insert", "needle.insert")
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
