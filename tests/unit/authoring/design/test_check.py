"""Faults of a step table are found where they are."""

from __future__ import annotations

import pytest
import tomli_w

from pcmrs.authoring.design import design
from pcmrs.fsm._codes import DESIGN
from tests.unit.authoring.design.step_tables import RATMS_STEPS, step, table

REFINED = {"branch": "in_b", "steps": [step("b1"), step("b2", "b1")]}
FAULTS: dict[str, tuple[bytes, str, str]] = {
    "no steps": (b'id = "x"\nversion = "1"\nsteps = []\n', "step_count", "steps"),
    "too many steps": (table(*(step(f"s{i}") for i in range(257))), "step_count", "steps"),
    "too many in one branch": (
        table(step("s0"), *(step(f"s{i}", f"s{i - 1}") for i in range(1, 33))),
        "step_count",
        "steps.0",
    ),
    "too many combinations": (
        table(step("s0"), *(step(f"s{i}", "s0") for i in range(1, 14))),
        "step_count",
        "steps.0",
    ),
    "too many joint states": (table(*(step(f"s{i}") for i in range(21))), "step_count", "steps"),
    "twice": (table(step("a"), step("a", operation="other")), "step_name", "steps.1.name"),
    "twice below": (table(step("b1"), step("b", refined_by=REFINED)), "step_name", "steps.1.refined_by.steps.0.name"),
    "unknown": (table(step("a"), step("b", "nobody")), "step_unknown", "steps.1.depends_on.0"),
    "of another level": (table(step("b", refined_by=REFINED), step("c", "b1")), "step_unknown", "steps.1.depends_on.0"),
    "cycle": (table(step("a", "c"), step("b", "a"), step("c", "b")), "step_cycle", "steps.0.depends_on"),
    "needs itself": (table(step("a", "a")), "step_cycle", "steps.0.depends_on"),
    "cycle below": (
        table(step("b", refined_by={"branch": "in_b", "steps": [step("p", "q"), step("q", "p")]})),
        "step_cycle",
        "steps.0.refined_by.steps.0.depends_on",
    ),
    "two branches": (table(step("a", branch="x"), step("b", "a", branch="y")), "step_branch", "steps.1.branch"),
    "branch below": (
        table(step("b", refined_by={"branch": "in_b", "steps": [step("p", branch="y")]})),
        "step_branch",
        "steps.0.refined_by.steps.0.branch",
    ),
    "one branch for two": (table(step("a", branch="x"), step("b", branch="x")), "name_collision", "steps.1"),
    "same operation": (table(step("a"), step("b", "a", operation="do_a")), "name_collision", "steps.1.operation"),
    "own reinit": (table(step("a", operation="reinit")), "name_collision", "steps.0.operation"),
    "reopened by doing": (table(step("a", reopened_by=["do_a"])), "name_collision", "steps.0.reopened_by.0"),
    "empty refinement": (table(step("b", refined_by={"branch": "in_b"})), "step_refinement", "steps.0.refined_by"),
    "points not performed": (
        table(step("b", refined_by={"branch": "in_b", "points": 3})),
        "step_refinement",
        "steps.0.refined_by",
    ),
    "refined and done": (table(step("b", refined_by=REFINED, checks=["c"])), "step_refinement", "steps.0"),
    "no points": (
        table(step("b", steps=["s"], refined_by={"branch": "in_b", "points": 0})),
        "bad_sequence",
        "steps.0.refined_by.points",
    ),
    "point twice": (
        table(step("b", steps=["s"], refined_by={"branch": "in_b", "points": ["p", "p"]})),
        "bad_sequence",
        "steps.0.refined_by.points.1",
    ),
    "python word": (table(step("a", operation="class")), "reserved_name", "steps.0.operation"),
    "bad id": (table(step("a"), id="x.y"), "bad_name", "id"),
    "bad deadline": (table(step("a", timeout_s=-1)), "bad_operation", "steps.0.operation"),
    "says nothing of the patient": (
        tomli_w.dumps({"id": "x", "version": "1", "steps": [{"name": "a", "operation": "do_a"}]}).encode(),
        "step_undeclared",
        "steps.0",
    ),
    "taken back by steps that say nothing": (
        table(step("a", reopened_by=[{"operation": "undo", "steps": ["s"]}])),
        "step_undeclared",
        "steps.0.reopened_by.0",
    ),
    "refined, and moves itself": (table(step("b", moves=True, refined_by=REFINED)), "step_hazard", "steps.0"),
    "moves below": (
        table(step("b", refined_by={"branch": "in_b", "steps": [step("p", moves=True)]})),
        "step_hazard",
        "steps.0.refined_by.steps.0",
    ),
    "irreversible by points": (
        table(step("b", irreversible=True, steps=["s"], refined_by={"branch": "in_b", "points": 2})),
        "step_hazard",
        "steps.0",
    ),
    "irreversible in several goes": (
        table(step("b", irreversible=True, alternatives=[{"operation": "try_b", "partial": True}])),
        "step_hazard",
        "steps.0.alternatives.0",
    ),
    "irreversible, and takes it back": (
        table(step("b", reopened_by=[{"operation": "undo", "irreversible": True}])),
        "step_hazard",
        "steps.0.reopened_by.0",
    ),
    "refined twice behind a motion": (
        table(
            step("a", moves=True),
            step(
                "b",
                "a",
                refined_by={
                    "branch": "in_b",
                    "steps": [step("p", refined_by={"branch": "in_p", "steps": [step("q")]})],
                },
            ),
        ),
        "step_hazard",
        "steps.1.refined_by",
    ),
    "unknown key": (table(step("a", colour="red")), "bad_value", "steps.0.colour"),
    "not TOML": (b'id = "x"\nsteps = [', "not_toml", ""),
    "not UTF-8": (b'id = "\xff"', "not_utf8", ""),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_where_it_is(name: str) -> None:
    raw, code, path = FAULTS[name]
    result = design(raw, origin="steps.toml")
    assert (result.text, {finding.code for finding in result.findings}) == ("", {code})
    finding = result.findings[0]
    assert finding.file == "steps.toml"
    assert ".".join(finding.path) == path, str(finding)


def test_there_is_a_table_for_every_kind_of_finding() -> None:
    assert {code for _, code, _ in FAULTS.values()} >= set(DESIGN)


def test_a_finding_has_line_and_column() -> None:
    raw = RATMS_STEPS.replace(b'["landmarks_digitized"]', b'["landmarks_digitised"]')
    (finding,) = design(raw, origin="steps.toml").findings
    line = raw.decode().splitlines()[finding.line - 1]
    assert line[finding.column - 1 :] == '"landmarks_digitised"]'
    assert str(finding).startswith(f"steps.toml:{finding.line}:{finding.column}: step_unknown: registered depends on")
