"""Requirements of a table: they become properties, which the verifier proves or refutes."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.authoring.design import design
from tests.unit.authoring.design.step_tables import blueprint_of, step, table


def required(**keys: Any) -> list[dict[str, Any]]:
    return [{"id": "promise", **keys}]


def findings(*steps: dict[str, Any], **keys: Any) -> list[tuple[str, tuple[str, ...]]]:
    found = design(table(*steps, requirements=required(**keys))).findings
    return [(finding.code, finding.path) for finding in found]


CONNECTED = (step("a"), step("b", "a"))
APART = (step("a"), step("b"))
BROKEN = [("property_violated", ("requirements", "0"))]


def test_a_requirement_becomes_a_property_of_the_blueprint() -> None:
    blueprint = blueprint_of(table(*CONNECTED, requirements=required(operation="do_b", holds=["a"], text="In words.")))
    (proved,) = blueprint.properties
    assert (proved.id, proved.text, proved.when.running) == ("promise", "In words.", ["procedure.do_b"])
    assert proved.always is not None
    assert proved.always.states == {"procedure": ["10", "11"]}


@pytest.mark.parametrize(
    ("steps", "keys", "expected"),
    [
        (CONNECTED, {"operation": "do_b", "holds": ["a"]}, []),
        (APART, {"operation": "do_b", "holds": ["a"]}, BROKEN),
        (CONNECTED, {"step": "b", "holds": ["a"]}, []),
        (APART, {"step": "b", "holds": ["a"]}, BROKEN),
        (CONNECTED, {"step": "b", "lacks": ["a"]}, BROKEN),
        ((step("a", irreversible=True), step("b", "a")), {"step": "b", "holds": ["a"]}, []),
    ],
)
def test_it_is_proved_or_refuted_in_all_joint_states(
    steps: tuple[dict[str, Any], ...], keys: dict[str, Any], expected: list[Any]
) -> None:
    """Steps that do not depend on each other are in different branches."""
    assert findings(*steps, **keys) == expected


def test_a_step_within_a_refinement_can_be_required() -> None:
    inner = {"refined_by": {"branch": "inner", "steps": [step("c") | {"moves": False}]}}
    assert findings(step("a", **inner), step("b", "a"), operation="do_b", holds=["a", "c"]) == []


@pytest.mark.parametrize(
    ("keys", "code"),
    [
        ({"operation": "do_b"}, "bad_property"),
        ({"holds": ["a"]}, "bad_property"),
        ({"operation": "do_b", "step": "b", "holds": ["a"]}, "bad_property"),
        ({"operation": "do_c", "holds": ["a"]}, "unknown_operation"),
        ({"operation": "do_b", "holds": ["c"]}, "step_unknown"),
        ({"step": "c", "lacks": ["a"]}, "step_unknown"),
    ],
)
def test_a_requirement_that_cannot_be_meant_is_a_finding(keys: dict[str, Any], code: str) -> None:
    assert findings(*CONNECTED, **keys) == [(code, ("requirements", "0"))]


def test_no_workflow_is_designed_from_an_unresolved_draft() -> None:
    designed = design(table(*CONNECTED, unresolved=["registered has no source."]))
    assert (designed.text, [finding.code for finding in designed.findings]) == ("", ["draft_unresolved"])
    assert "registered has no source." in designed.findings[0].text
