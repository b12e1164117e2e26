"""Reads what a model has answered: a step table, or findings why it is none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import msgspec
import tomli_w

from pcmrs.authoring.design import design, paths_of
from pcmrs.authoring.design.tables import StepTable
from pcmrs.authoring.drafting._schema import foreign_keys
from pcmrs.fsm.blueprint import ProvenanceSpec
from pcmrs.fsm.finding import Finding, Path

VERSION = "0.1.0"
"""Version of each draft."""
TOP = 2
"""Number of keys in the path of a step of the first level."""


@dataclass(frozen=True, slots=True)
class ExaminedAnswer:
    """One answer of a model.

    Attributes:
        table: The step table; None if it is none.
        text: The table as TOML; empty if it is none.
        blueprint: The workflow that it makes; empty if there are findings.
        findings: All that is wrong.
    """

    table: StepTable | None = None
    text: str = ""
    blueprint: str = ""
    findings: list[Finding] = field(default_factory=list)


def examine_answer(answer: str, protocol: str, provenance: ProvenanceSpec, *, complete: bool) -> ExaminedAnswer:
    """Read an answer, and prove its workflow.

    Args:
        answer: Text of the answer.
        protocol: Text of the protocol.
        provenance: Origin of the draft.
        complete: The model has ended the answer by itself.
    """
    if not complete:
        return _no_table("The answer was cut at the limit of its length: write a shorter one, with fewer assumptions.")
    try:
        given = msgspec.json.decode(answer)
    except (msgspec.DecodeError, RecursionError) as error:
        return _no_table(f"The answer is not JSON: {error}. Write the JSON object alone, without any text around it.")
    if not isinstance(given, dict):
        return _no_table("The answer is not a JSON object: write one with the keys of the schema.")
    foreign = list(_foreign(given))
    if foreign:
        return ExaminedAnswer(findings=foreign)
    try:
        table = msgspec.convert({**given, "version": VERSION}, StepTable)
    except msgspec.ValidationError as error:
        return _no_table(f"The answer does not follow the schema: {error}.")
    table = msgspec.structs.replace(table, provenance=provenance)
    text = table_text(table)
    designed = design(text.encode(), origin="table")
    findings = [*_sources(table, protocol), *designed.findings]
    return ExaminedAnswer(table, text, "" if findings else designed.text, findings)


def table_text(table: StepTable, comment: str = "") -> str:
    """Return a table as TOML.

    Args:
        table: The table.
        comment: Lines for the head of the file.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    return "\n".join([*lines, tomli_w.dumps(_without_none(msgspec.to_builtins(table)))])


def _no_table(text: str) -> ExaminedAnswer:
    return ExaminedAnswer(findings=[Finding(code="draft_answer", text=text)])


def _foreign(given: dict[str, Any], above: Path = (), kind: str = "StepTable") -> Iterator[Finding]:
    """Return findings on keys that a model must not give, in a table and in all tables below it."""
    for key in foreign_keys(kind, given):
        text = f"`{key}` is not for you to write: leave it out."
        yield Finding(code="draft_code", text=text, path=(*above, key))
    steps = given.get("steps")
    if kind in ("StepTable", "RefinementSpec") and isinstance(steps, list):
        for i, step in enumerate(steps):
            if isinstance(step, dict):
                yield from _foreign(step, (*above, "steps", str(i)), "StepSpec")
    if isinstance(given.get("refined_by"), dict):
        yield from _foreign(given["refined_by"], (*above, "refined_by"), "RefinementSpec")
    for key, inner in (("alternatives", "AlternativeSpec"), ("reopened_by", "ActionSpec")):
        actions = given.get(key)
        for i, action in enumerate(actions if isinstance(actions, list) else ()):
            if isinstance(action, dict):
                yield from _foreign(action, (*above, key, str(i)), inner)


def _sources(table: StepTable, protocol: str) -> Iterator[Finding]:
    """Return findings on steps and requirements whose sentence is not in the protocol."""
    known = plain(protocol)
    named = [(path, step.name, step.source) for path, step in paths_of(table.steps)]
    named += [(("requirements", str(i)), each.id, each.source) for i, each in enumerate(table.requirements)]
    for path, name, source in named:
        if not source.strip():
            text = f"{name} has no `source`: copy the sentence of the protocol that it comes from."
            yield Finding(code="draft_source", text=text, path=path)
        elif plain(source) not in known:
            text = f"The `source` of {name} is not a sentence of the protocol: {source[:200]!r}. Copy it unchanged, or "
            text += "leave the step out if the protocol does not ask for it."
            yield Finding(code="draft_source", text=text, path=path)


def plain(text: str) -> str:
    """Return a text without differences in white space, marks of Markdown and capitals."""
    return " ".join(text.replace("*", "").replace("`", "").split()).casefold()


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(inner) for key, inner in value.items() if inner is not None}
    return [_without_none(inner) for inner in value] if isinstance(value, list) else value
