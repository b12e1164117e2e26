"""Evaluation of a model: how many properties of the right workflows its drafts have, after how many rounds.

A property speaks of sentences of the protocol and not of names, because every model names its steps differently: a
sentence stands for all steps whose `source` it is in.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import msgspec

from pcmrs.authoring.design import design, paths_of
from pcmrs.authoring.design.tables import DECLARATIONS, RequirementSpec, StepSpec, StepTable
from pcmrs.authoring.drafting._answer import plain, table_text
from pcmrs.authoring.drafting.loop import Draft


class ExpectedProperty(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A property of the right workflow; it has either `holds` or `declares`.

    Attributes:
        id: Name of the property.
        sentence: Sentence of the protocol. Whenever an operation of a step from it runs,
        holds: all steps from these sentences are achieved.
        declares: Effects on the patient that a step from the sentence declares.
    """

    id: str
    sentence: str
    holds: list[str] = []
    declares: list[str] = []


class Expectation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All properties of the right workflow of a protocol."""

    properties: list[ExpectedProperty]


@dataclass(frozen=True, slots=True)
class EvaluationProtocol:
    """A protocol with the properties of its right workflow.

    Attributes:
        name: Its name.
        text: Its text.
        properties: The properties.
    """

    name: str
    text: str
    properties: list[ExpectedProperty]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Result for one protocol.

    Attributes:
        protocol: Name of the protocol.
        properties: Number of properties of its right workflow.
        held: Number of them that hold after each round.
        missing: Those that do not hold in the end.
        proved: The draft is proved.
    """

    protocol: str
    properties: int
    held: list[int]
    missing: list[str]
    proved: bool


def evaluation_protocols() -> list[EvaluationProtocol]:
    """Return the protocols of PCMRS, in the order of their names."""
    folder = files("pcmrs.authoring.drafting") / "protocols"
    names = sorted(each.name.removesuffix(".md") for each in folder.iterdir() if each.name.endswith(".md"))
    found = []
    for name in names:
        content = tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))
        expected = msgspec.convert(content, Expectation)
        text = (folder / f"{name}.md").read_text(encoding="utf-8")
        found.append(EvaluationProtocol(name, text, expected.properties))
    return found


def evaluate(protocol: EvaluationProtocol, draft: Draft) -> Evaluation:
    """Return how many properties of the right workflow a draft has, after each of its rounds.

    Args:
        protocol: The protocol.
        draft: Draft of its table.
    """
    missing = [missing_properties(each.table, protocol.properties) for each in draft.rounds]
    number = len(protocol.properties)
    return Evaluation(
        protocol.name, number, [number - len(each) for each in missing], missing[-1], proved=bool(draft.blueprint)
    )


def missing_properties(table: StepTable | None, expected: Sequence[ExpectedProperty]) -> list[str]:
    """Return the properties that the workflow of a table does not have; all of them if it makes no workflow.

    Args:
        table: The table; None if an answer was none.
        expected: The properties.
    """
    if table is None:
        return [each.id for each in expected]
    made = {each.id: _requirements(table, each) for each in expected}
    owners = [(name, requirement) for name, each in made.items() for requirement in each or ()]
    wanted = [msgspec.structs.replace(each, id=f"expected_{i}") for i, (_, each) in enumerate(owners)]
    bare = msgspec.structs.replace(table, requirements=wanted, unresolved=[])
    findings = design(table_text(bare).encode()).findings
    if any(finding.path[:1] != ("requirements",) for finding in findings):
        return [each.id for each in expected]
    broken = {owners[int(finding.path[1])][0] for finding in findings}
    return [name for name, each in made.items() if each is None or name in broken]


def _requirements(table: StepTable, expected: ExpectedProperty) -> list[RequirementSpec] | None:
    """Return the requirements that a property makes of a table; None if it cannot hold."""
    steps = _steps_from(table, expected.sentence)
    needed = [_steps_from(table, sentence) for sentence in expected.holds]
    if not steps or not all(needed):
        return None
    if not any(all(_declares(step, key) for key in expected.declares) for step in steps):
        return None
    if not needed:
        return []
    names = [step.name for each in needed for step in each]
    return [RequirementSpec(id=expected.id, operation=step.operation, holds=names) for step in steps]


def _steps_from(table: StepTable, sentence: str) -> list[StepSpec]:
    wanted = plain(sentence)
    return [step for _, step in paths_of(table.steps) if wanted in plain(step.source)]


def _declares(step: StepSpec, key: str) -> bool:
    return key in DECLARATIONS and bool(getattr(step, key))
