"""The part of a step table that a model may write, as JSON Schema: no functions, no version, no provenance."""

from __future__ import annotations

import inspect
import re
from functools import cache
from typing import Any

import msgspec

from pcmrs.authoring.design import tables
from pcmrs.authoring.design.tables import StepTable

CODE = ("payload", "checks", "steps", "timeout_s")
"""Keys of an action that name functions or their limits: engineers add them."""
LEFT_OUT = {
    "StepTable": ("version", "provenance", "unresolved"),
    "RefinementSpec": ("points", "item"),
    "StepSpec": CODE,
    "ActionSpec": CODE,
    "AlternativeSpec": CODE,
}
"""Keys of each table that a model must leave out."""

_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.MULTILINE)


@cache
def answer_schema() -> dict[str, Any]:
    """Return the schema of an answer.

    All keys are required, as the strict mode of the interface demands: a model must then decide about each of them.
    """
    definitions: dict[str, Any] = msgspec.json.schema(StepTable)["$defs"]
    del definitions["ProvenanceSpec"]
    for name, definition in definitions.items():
        for key in LEFT_OUT.get(name, ()):
            del definition["properties"][key]
        definition["description"] = definition["description"].partition("\n\n")[0]
        meanings = _meanings(getattr(tables, name))
        for key, value in definition["properties"].items():
            value.pop("default", None)
            if key in meanings and "$ref" not in value:
                value["description"] = meanings[key]
        definition["required"] = list(definition["properties"])
    return {**definitions.pop("StepTable"), "$defs": definitions}


def foreign_keys(name: str, table: dict[str, Any]) -> list[str]:
    """Return the keys of a table that a model must leave out and has given all the same.

    Args:
        name: Name of its type.
        table: The table, as the model has given it.
    """
    return [key for key in LEFT_OUT.get(name, ()) if key in table]


def _meanings(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Return the texts of the attributes of a struct and of its bases."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        texts = _ATTRIBUTE.findall(inspect.getdoc(base) or "") if issubclass(base, msgspec.Struct) else []
        found |= {key: " ".join(text.split()) for key, text in texts}
    return found
