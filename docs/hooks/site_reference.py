"""Fill `{{ name }}` in a page from the code, so that no page can be older than the code."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from itertools import groupby
from typing import Any

import msgspec
from origins import origin_of
from python_api import MODULE, module_section
from refusals import refusals
from schema_tables import Schema, definition_body, definition_section, name_of, plain

from pcmrs import errors
from pcmrs.authoring.exchange.exporting.schema import schema as blueprint_schema
from pcmrs.bus.keys import KEYS
from pcmrs.settings import DRIVER_SETTINGS, Settings
from pcmrs.workflows import read_workflow

WORKFLOWS = ("ratms", "femoroplasty", "grid_mapping", "ratms_threshold")
MESSAGES = (
    "pcmrs.messages",
    "pcmrs.messages.health",
    "pcmrs.messages.setup",
    "pcmrs.bus.keys",
    "pcmrs.bus.stop",
)
"""Modules with the types that the table of keys names."""


OWN_TYPE = re.compile(r"(?<!/)\b(?!CDR:)[A-Z]\w+")
"""One of our types in a payload; types of ROS 2 follow a slash."""


def on_page_markdown(markdown: str, **_context: Any) -> str:
    """Fill the page."""
    markdown = MODULE.sub(lambda found: "\n".join(module_section(found[1], found[2].split())), markdown)
    return re.sub(r"^\{\{ (\w+) \}\}$", lambda found: "\n".join(FILLED[found[1]]()), markdown, flags=re.MULTILINE)


def keys_of_bus() -> Iterator[str]:
    """Yield the table of keys, and the schema of every payload."""
    types = _message_types()
    yield "| key | use | payload | purpose | users | served by |\n| --- | --- | --- | --- | --- | --- |"
    for row in KEYS:
        payload = OWN_TYPE.sub(
            lambda name: f"[{name[0]}](#{name[0].lower()})" if name[0] in types else name[0], row.payload
        )
        who = ", ".join(row.users), ", ".join(row.owners)
        yield f"| `{row.key}` | {row.use} | {_cell(payload)} | {_cell(row.text)} | {who[0]} | {who[1]} |"
    named = dict.fromkeys(name for row in KEYS for name in OWN_TYPE.findall(row.payload) if name in types)
    _, components = msgspec.json.schema_components([types[name] for name in named])
    yield "\n## Payloads\n"
    for name, definition in components.items():
        yield from definition_section(name, definition)


def settings() -> Iterator[str]:
    """Yield every table of the configuration, those of the drivers last."""
    points = sorted(entry_points(group=DRIVER_SETTINGS), key=lambda point: point.name)
    drivers = {point.name: point.load() for point in points}
    _, components = msgspec.json.schema_components([Settings, *drivers.values()])
    shown: set[str] = set()
    yield from _tables("", "Settings", components, shown)
    for name, kind in drivers.items():
        yield from _tables(name, kind.__name__, components, shown)


def blueprint() -> Iterator[str]:
    """Yield the parts of a blueprint."""
    for name, definition in json.loads(blueprint_schema())["$defs"].items():
        if not name.startswith("Partial"):
            yield from definition_section(name, definition, "##")


def error_types() -> Iterator[str]:
    """Yield the tree of errors."""
    yield "| code | type | meaning |\n| --- | --- | --- |"
    yield from _below(errors.PcmrsError, 0)


def refusal_codes() -> Iterator[str]:
    """Yield the codes of refusals with their texts."""
    yield "| code | text | module |\n| --- | --- | --- |"
    for code, places in groupby(refusals(), key=lambda refusal: refusal.code):
        known = list(places)
        texts = dict.fromkeys(plain(place.text) for place in known if place.text)
        modules = dict.fromkeys(f"`{place.module}`" for place in known)
        yield f"| `{code}` | {'<br>'.join(map(_cell, texts))} | {', '.join(modules)} |"


def workflow_refusals() -> Iterator[str]:
    """Yield the codes that blueprints give to unmet requirements."""
    found: dict[str, list[str]] = {}
    for workflow in WORKFLOWS:
        for name, branch in read_workflow(workflow).branches.items():
            for operation, spec in branch.operations.items():
                given = spec.refusal
                for code in given.values() if isinstance(given, Mapping) else [given]:
                    if code and f"`{name}.{operation}`" not in (places := found.setdefault(code, [])):
                        places.append(f"`{name}.{operation}`")
    yield "| code | operations |\n| --- | --- |"
    for code, places in sorted(found.items()):
        yield f"| `{code}` | {', '.join(places)} |"


def _tables(path: str, name: str, components: Mapping[str, Schema], shown: set[str]) -> Iterator[str]:
    """Yield a table and those below it; a type of several tables is shown at the first."""
    if name in shown:
        return
    shown.add(name)
    yield f"## {f'`[{path}]`' if path else 'The root'} {{ #{name.lower()} }}\n"
    yield from definition_body(components[name], partial(origin_of, path))
    for key, value in components[name]["properties"].items():
        inner = f"{path}.{key}".lstrip(".")
        for more, at in ((value, inner), (value.get("items"), f"[{inner}]"), (_named(value), f"{inner}.<name>")):
            if more and "$ref" in more:
                yield from _tables(at, name_of(more["$ref"]), components, shown)


def _named(value: Schema) -> Schema | None:
    """Return the type of the values that the user names in a table."""
    more = value.get("additionalProperties")
    return more if isinstance(more, Mapping) else None


def _message_types() -> dict[str, type[msgspec.Struct]]:
    modules = map(import_module, MESSAGES)
    return {name: kind for module in modules for name, kind in vars(module).items() if isinstance(kind, type)}


def _below(error: type[errors.PcmrsError], depth: int) -> Iterator[str]:
    documentation = (error.__doc__ or "").partition("\n\n")[0]
    yield f"| `{error.code}` | {'↳ ' * depth}`{error.__name__}` | {_cell(plain(documentation))} |"
    for inner in error.__subclasses__():
        yield from _below(inner, depth + 1)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


FILLED: dict[str, Callable[[], Iterator[str]]] = {
    "keys_of_bus": keys_of_bus,
    "settings": settings,
    "blueprint": blueprint,
    "error_types": error_types,
    "refusal_codes": refusal_codes,
    "workflow_refusals": workflow_refusals,
}
