"""The schema that a model gets: the step table without what it must not write."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import jsonschema
import pytest

from pcmrs.authoring.drafting._answer import examine_answer
from pcmrs.authoring.drafting._prompt import first_messages
from pcmrs.authoring.drafting._schema import answer_schema
from pcmrs.fsm.blueprint import ProvenanceSpec

SYSTEM = first_messages("")[0]["content"]
PROTOCOLS = [part.partition("\n\nAnswer:")[0].removeprefix("> ") for part in SYSTEM.split("Protocol:\n\n")[1:]]
ANSWERS = [part.partition("\n```")[0] for part in SYSTEM.split("```json\n")[1:]]
ORIGIN = ProvenanceSpec(model="made", prompt="", protocol="", date="")


def objects(value: Any) -> list[dict[str, Any]]:
    """All schemas of objects in a schema."""
    if isinstance(value, list):
        return [each for inner in value for each in objects(inner)]
    if not isinstance(value, dict):
        return []
    own = [value] if value.get("type") == "object" else []
    return own + [each for inner in value.values() for each in objects(inner)]


def test_the_schema_is_of_the_strict_kind() -> None:
    """Every key is required, and no other is allowed: servers with constrained sampling need that."""
    schema = answer_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    assert len(objects(schema)) >= 6
    for each in objects(schema):
        assert each["additionalProperties"] is False
        assert sorted(each["required"]) == sorted(each["properties"])


def test_a_model_can_name_no_functions() -> None:
    step = answer_schema()["$defs"]["StepSpec"]["properties"]
    assert not {"steps", "checks", "payload", "timeout_s"} & set(step)
    assert "Sentence of the protocol" in step["source"]["description"]
    assert not {"version", "provenance", "unresolved"} & set(answer_schema()["properties"])
    assert "Attributes:" not in json.dumps(answer_schema()), "the texts would name the keys that are left out"


@pytest.mark.parametrize(("protocol", "answer"), list(zip(PROTOCOLS, ANSWERS, strict=True)))
def test_the_examples_follow_the_schema_and_are_proved(protocol: str, answer: str) -> None:
    jsonschema.validate(json.loads(answer), answer_schema())
    examined = examine_answer(answer, protocol, ORIGIN, complete=True)
    assert examined.findings == []
    assert tomllib.loads(examined.blueprint)["provenance"]["model"] == "made"


def test_there_are_two_examples_and_a_glossary() -> None:
    assert len(ANSWERS) == len(PROTOCOLS) == 2
    assert "# Glossary" in SYSTEM
