"""A JSON Schema as tables in Markdown: one row for each key, with its type, default and meaning."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from inspect import cleandoc
from typing import Any

Schema = Mapping[str, Any]

_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.MULTILINE)
_BOUNDS = {
    "minimum": "≥ {}",
    "exclusiveMinimum": "> {}",
    "maximum": "≤ {}",
    "exclusiveMaximum": "< {}",
    "minLength": "at least {} letters",
    "maxLength": "at most {} letters",
    "minItems": "at least {}",
    "maxItems": "at most {}",
    "pattern": "like `{}`",
}
_LONGEST = 60
"""Greatest length of a default that is shown; a longer one is the default of its type."""


def definition_section(name: str, definition: Schema, level: str = "###") -> Iterator[str]:
    """Yield heading, description, and the table of keys."""
    yield f"{level} {name}\n"
    yield from definition_body(definition)


def definition_body(definition: Schema, origin: Callable[[str], str] | None = None) -> Iterator[str]:
    """Yield the description of a type and the table of its keys; for a type without keys, its values.

    Args:
        definition: The type.
        origin: Returns where the default of a key comes from, for one more column.
    """
    documentation = cleandoc(definition.get("description", ""))
    yield plain(documentation.partition("\n\n")[0]) + "\n"
    if "properties" not in definition:
        yield f"{type_text(definition)}\n"
    elif definition["properties"]:
        origins = ("", "") if origin is None else (" origin of the default |", " --- |")
        yield f"| key | type | default | meaning |{origins[0]}\n| --- | --- | --- | --- |{origins[1]}"
        meanings = {key: plain(text) for key, text in _ATTRIBUTE.findall(documentation)}
        for key, value in definition["properties"].items():
            required = key in definition.get("required", ())
            row = _row(key, value, required, meanings.get(key, ""))
            yield row if origin is None else f"{row} {'' if required or '$ref' in value else origin(key)} |"
    yield ""


def plain(text: str) -> str:
    """Return a docstring as one line of Markdown."""
    return " ".join(text.split()).replace("``", "`")


def name_of(ref: str) -> str:
    """Return the name at the end of a reference, ``#/$defs/Name``."""
    return ref.rpartition("/")[2]


def type_text(value: Schema) -> str:
    """Return the type of a value in words, with its bounds; our own types are links to their section."""
    bounds = [text.format(_json(value[key])) for key, text in _BOUNDS.items() if key in value]
    return ", ".join([_kind(value), *(bound.replace("|", "\\|") for bound in bounds)])


def _row(key: str, value: Schema, required: bool, meaning: str) -> str:
    default = "" if required or "default" not in value else f"`{_json(value['default'])}`"
    if len(default) > _LONGEST:
        default = "see there" if "$ref" in value else "…"
    what = value.get("description", meaning) if "$ref" not in value else meaning
    cells = (f"`{key}`", type_text(value), "needed" if required else default, plain(what).replace("|", "\\|"))
    return f"| {' | '.join(cells)} |"


def _kind(value: Schema) -> str:
    if "$ref" in value:
        name = name_of(value["$ref"])
        return f"[{name}](#{name.lower()})"
    if "anyOf" in value:
        return " or ".join(type_text(each) for each in value["anyOf"])
    if "enum" in value:
        return ", ".join(f"`{_json(each)}`" for each in value["enum"])
    if "prefixItems" in value:
        parts = [type_text(each) for each in value["prefixItems"]]
        return f"{len(parts)} × {parts[0]}" if len(set(parts)) == 1 else f"[{', '.join(parts)}]"
    kind: str = value.get("type", "anything")
    if kind == "array" and value.get("items"):
        return f"list of {type_text(value['items'])}"
    if kind == "object" and isinstance(value.get("additionalProperties"), Mapping):
        return f"table of {type_text(value['additionalProperties'])} by name"
    return {"object": "table", "array": "list", "null": "none"}.get(kind, kind)


def _json(value: Any) -> str:
    return value if isinstance(value, str) and value else json.dumps(value, ensure_ascii=False)
