"""The transition table of a workflow."""

from __future__ import annotations

import pytest

from pcmrs.authoring.exchange.exporting.table import COLUMNS, table
from pcmrs.fsm.behaviour import behaviour, endings
from pcmrs.fsm.closure import Denial
from tests.support.shipped import NAMES, shipped_blueprint


def rows(text: str) -> list[dict[str, str]]:
    lines = [line.removeprefix("| ").removesuffix(" |").split(" | ") for line in text.splitlines() if line[:1] == "|"]
    return [dict(zip(COLUMNS, (cell.strip() for cell in line), strict=True)) for line in lines[2:]]


@pytest.mark.parametrize("name", NAMES)
def test_every_way_an_operation_can_end_has_a_row(name: str) -> None:
    blueprint = shipped_blueprint(name)
    endings = sum(
        len(operation.endings) + (operation.on_failure is not None) + (operation.on_unknown is not None)
        for spec in blueprint.branches.values()
        for operation in spec.operations.values()
    )
    revocations = sum(len(spec.revocations) for spec in blueprint.branches.values())
    activities = sum(len(spec.activities) for spec in blueprint.branches.values())
    found = rows(table(blueprint))
    assert len(found) == endings + revocations + activities
    assert sum(row["operation"] == "revoked" for row in found) == revocations


def test_the_table_says_what_an_operation_needs_and_does() -> None:
    shown = rows(table(shipped_blueprint("ratms")))
    found = {row["operation"]: row for row in shown if row["branch"] != "toolplan (1)"}
    assert found["use_previous"] == {
        "branch": "registration (1)",
        "operation": "use_previous",
        "from → to": "any → 111",
        "requires": "",
        "checks": "calibration_valid, previous_registration_fits",
        "steps": "take_previous_registration",
        "asked by": "anyone",
        "calls": "digitization := 1",
    }
    assert found["approach (approach)"]["requires"] == "registration 111; toolplan 1; robot 1"
    assert found["redigitize_one"]["calls"] == "registration.undigitized"
    assert (found["link_lost"]["asked by"], found["digitized (IIO)"]["asked by"]) == ("a device", "a child")


@pytest.mark.parametrize("name", NAMES)
def test_calls_are_the_parent_operations_that_the_workflow_calls(name: str) -> None:
    """Oracle: the closures of every operation in every joint state, cascades of the parent's own left out."""
    blueprint = shipped_blueprint(name)
    called: dict[str, set[str]] = {}
    for rulings in behaviour(blueprint).values():
        for name, said in rulings.items():
            branch, operation = name.split(".")
            parent = blueprint.branches[branch].parent
            if parent is None or isinstance(said, Denial):
                continue
            changes = endings(blueprint.branches[branch].operations[operation], said).values()
            effects = [effect for change in changes if change is not None for effect in change.effects]
            called.setdefault(name, set()).update(
                f"{parent.branch}.{effect.operation}"
                for effect in effects
                if effect.kind == "signal" and effect.branch == parent.branch
            )
    listed: dict[str, set[str]] = {}
    branch = operation = ""
    for row in rows(table(blueprint)):
        if row["operation"] != "revoked":
            branch = row["branch"].split(" ")[0] or branch
            operation = row["operation"].split(" ")[0].removesuffix(":") if row["branch"] else operation
            calls = {call for call in row["calls"].split(", ") if call and ":=" not in call}
            listed.setdefault(f"{branch}.{operation}", set()).update(calls)
    assert called
    assert {name: calls for name, calls in listed.items() if name in called} == called
