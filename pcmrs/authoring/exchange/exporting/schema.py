"""The JSON Schema of a blueprint file, with which editors complete and check it while it is written."""

from __future__ import annotations

import inspect
import re
from typing import Any

import msgspec

from pcmrs.fsm import blueprint as parts
from pcmrs.fsm.blueprint import Blueprint, BlueprintPart
from pcmrs.fsm.files.extend import EXTENDS, FILE_NAME
from pcmrs.fsm.rules.names import NAME, STATE_NAME

__all__ = ["schema"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
ANY = r"\*"
PARTIAL = "Partial"
"""Prefix of the names of the parts of a file that extends another."""

NAMES = {
    ("Blueprint", "branches"): NAME.pattern,
    ("BranchSpec", "activities"): STATE_NAME.pattern,
    ("BranchSpec", "operations"): NAME.pattern,
    ("BranchSpec", "states"): STATE_NAME.pattern,
    ("BranchSpec", "timers"): NAME.pattern,
    ("BranchSpec", "emits"): f"{STATE_NAME.pattern}|{ANY}",
    ("OperationSpec", "outcomes"): NAME.pattern,
    ("ParentSpec", "compatible"): f"{STATE_NAME.pattern}|{ANY}",
}
"""Pattern of the keys of each table."""

_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.MULTILINE)


def schema() -> str:
    """Return the JSON Schema as text. It says what a file may hold; `pcmrs fsm verify` checks whether that is sound."""
    whole = msgspec.json.schema(Blueprint)["$defs"]
    for name, definition in whole.items():
        _describe(name, definition, getattr(parts, name))
    del whole["Blueprint"]["properties"]["hash"]
    document = {
        "$schema": DIALECT,
        "title": "PCMRS blueprint",
        "if": {"required": [EXTENDS]},
        "then": {"$ref": f"#/$defs/{PARTIAL}Blueprint"},
        "else": {"$ref": "#/$defs/Blueprint"},
        "$defs": whole | _partial(whole),
    }
    return msgspec.json.format(msgspec.json.encode(document), indent=2).decode() + "\n"


def _partial(whole: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a file that extends another: no key is required."""
    text = msgspec.json.encode(whole).replace(b"#/$defs/", f"#/$defs/{PARTIAL}".encode())
    definitions: dict[str, Any] = msgspec.json.decode(text)
    for definition in definitions.values():
        definition["required"] = []
    blueprint = definitions["Blueprint"]
    blueprint["required"] = [EXTENDS, "id", "version"]
    blueprint["properties"][EXTENDS] = {
        "type": "string",
        "pattern": f"^(?:{FILE_NAME.pattern})$",
        "description": "The file beside this one that is read first; the tables of this file are merged into it.",
    }
    return {PARTIAL + name: definition for name, definition in definitions.items()}


def _describe(name: str, definition: dict[str, Any], part: type[BlueprintPart]) -> None:
    """Add what the attributes mean, and patterns of names."""
    documentation = inspect.getdoc(part) or ""
    definition["description"] = documentation.partition("\n\n")[0].replace("\n", " ")
    meanings = {key.rstrip("_"): " ".join(text.split()) for key, text in _ATTRIBUTE.findall(documentation)}
    for key, value in definition["properties"].items():
        if key in meanings:
            value["description"] = meanings[key].replace("``", "`")
        if (name, key) in NAMES:
            value["propertyNames"] = {"pattern": f"^(?:{NAMES[name, key]})$"}
