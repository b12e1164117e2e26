"""Operations of a designed branch: where they are valid, and what they open again."""

from __future__ import annotations

from pcmrs.fsm import Engine
from tests.unit.authoring.design.step_tables import GRID_STEPS, HEEDED, blueprint_of, step, table


def test_step_needs_its_dependencies_and_a_grid_goes_in_order() -> None:
    engine = Engine(blueprint_of(GRID_STEPS))
    assert engine.allowed("grid") == ["reinit"]
    for branch, operation in [
        ("preparation", "plan_landmarks"),
        ("preparation", "plan"),
        ("digitization", "digitize_all"),
        ("preparation", "register"),
    ]:
        assert engine.allowed("grid") == ["reinit"]
        engine.perform(branch, operation)
    engine.perform("grid", "perform")
    engine.perform("grid", "perform", "failed")
    assert engine.joint()["grid"] == "point_2_stopped"
    assert engine.allowed("grid") == ["repeat", "skip", "abandon", "reinit"]
    for _ in range(8):
        assert engine.joint()["preparation"] == "11110"
        engine.perform("grid", "skip")
    assert engine.joint() == {"preparation": "11111", "digitization": "1", "grid": "done", **HEEDED}


def test_doing_a_step_again_begins_what_rests_on_it_again() -> None:
    blueprint = blueprint_of(GRID_STEPS)
    engine = Engine(blueprint)
    start = {"preparation": "11110", "digitization": "1", **HEEDED}
    for operation in ("register", "plan"):
        engine.place(start | {"grid": "point_5_stopped"})
        engine.perform("preparation", operation)
        assert engine.joint() == start | {"grid": "point_1"}
    engine.place({"preparation": "11111", "digitization": "1", "grid": "done"})
    engine.perform("digitization", "digitize_all")
    assert engine.joint() == {"preparation": "11010", "digitization": "1", "grid": "point_1", **HEEDED}


def test_roles_criteria_and_deadlines_arrive_at_the_operation() -> None:
    keys = {"roles": ["operator"], "checks": ["c"], "steps": ["s"], "payload": "p", "timeout_s": 7}
    blueprint = blueprint_of(table(step("a", reopened_by=["undo"], **keys)))
    operations = blueprint.branches["procedure"].operations
    made = operations["do_a"]
    assert (made.roles, made.checks, made.steps, made.payload, made.timeout_s) == (["operator"], ["c"], ["s"], "p", 7)
    assert operations["undo"].roles == ["operator"]


def test_one_operation_may_reopen_several_steps() -> None:
    raw = table(step("a", reopened_by=["clear"]), step("b", "a"), step("c", "a", reopened_by=["clear"]), step("d", "c"))
    engine = Engine(blueprint_of(raw))
    engine.place({"procedure": "1111"})
    engine.perform("procedure", "clear")
    assert engine.joint() == {"procedure": "0000"}
