"""The JSON Schema of blueprints."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pcmrs.authoring.exchange.exporting.schema import schema

WORKFLOWS = sorted(Path("pcmrs/workflows").glob("*.toml"))


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
