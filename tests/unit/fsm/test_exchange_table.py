"""The transition table and the JSON Schema of blueprints."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pcmrs.authoring.exchange.exporting.schema import schema
from pcmrs.authoring.exchange.exporting.table import COLUMNS, table
from pcmrs.fsm import Blueprint
from pcmrs.fsm.behaviour import behaviour, endings
from pcmrs.fsm.closure import Denial
from pcmrs.fsm.files.load import read_blueprint

WORKFLOWS = sorted(Path("pcmrs/workflows").glob("*.toml"))


def workflow(path: Path) -> Blueprint:
    blueprint, findings = read_blueprint(path.read_bytes(), str(path), path.parent)
    assert blueprint is not None, findings
    return blueprint


def rows(text: str) -> list[dict[str, str]]:
    lines = [line.removeprefix("| ").removesuffix(" |").split(" | ") for line in text.splitlines() if line[:1] == "|"]
    return [dict(zip(COLUMNS, (cell.strip() for cell in line), strict=True)) for line in lines[2:]]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_every_way_an_operation_can_end_has_a_row(path: Path) -> None:
    blueprint = workflow(path)
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
    shown = rows(table(workflow(Path("pcmrs/workflows/ratms.toml"))))
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


def test_the_schema_in_the_documentation_is_current() -> None:
    assert Path("docs/blueprint.schema.json").read_text() == schema()


def check(given: dict[str, Any]) -> list[str]:
    """What the schema has against a blueprint."""
    jsonschema = pytest.importorskip("jsonschema")
    return [error.message for error in jsonschema.Draft202012Validator(json.loads(schema())).iter_errors(given)]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_the_schema_takes_every_workflow(path: Path) -> None:
    assert check(tomllib.loads(path.read_text())) == []


@pytest.mark.parametrize(
    "spoil",
    [
        lambda given: given.update(versoin="1"),
        lambda given: given.pop("id"),
        lambda given: given["branches"].update({"Robot Arm": {}}),
        lambda given: given["branches"]["robot"].update(level="two"),
        lambda given: given["branches"]["robot"]["operations"]["connect"].update(motion="sideways"),
        lambda given: given["branches"]["robot"]["operations"]["connect"].pop("from"),
        lambda given: given["branches"]["robot"]["states"].update({"a state": "x"}),
        lambda given: given.update(hash="0"),
    ],
)
def test_the_schema_refuses_what_is_no_blueprint(spoil: Callable[[dict[str, Any]], None]) -> None:
    given = tomllib.loads(Path("pcmrs/workflows/ratms.toml").read_text())
    spoil(given)
    assert len(check(given)) == 1


def test_the_schema_explains_every_key_that_the_code_explains() -> None:
    operation = json.loads(schema())["$defs"]["OperationSpec"]["properties"]
    assert operation["from"]["description"] == 'States it is valid in; `["*"]` for all.'
    assert not [key for key, value in operation.items() if not value.get("description")]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_calls_are_the_parent_operations_that_the_workflow_calls(path: Path) -> None:
    """Oracle: the closures of every operation in every joint state, cascades of the parent's own left out."""
    blueprint = workflow(path)
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
