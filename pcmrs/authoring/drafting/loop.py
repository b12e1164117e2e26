"""The loop from a protocol to a proved table: ask, design, verify, and give every finding back in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from pcmrs.authoring.design.tables import StepTable
from pcmrs.authoring.drafting._answer import ExaminedAnswer, examine_answer, table_text
from pcmrs.authoring.drafting._prompt import first_messages, hash_of, next_messages, prompt_hash
from pcmrs.authoring.drafting._schema import answer_schema
from pcmrs.authoring.drafting._words import in_words
from pcmrs.authoring.drafting.client import ModelClient
from pcmrs.authoring.drafting.text_checks import questions_about
from pcmrs.fsm.blueprint import ProvenanceSpec

MOST_ROUNDS = 6
"""Default limit of rounds."""
MOST_FINDINGS = 20
"""Number of findings that are given back in one round: further ones often follow from the first."""
HEAD = """\
Drafted by a language model (see [provenance]). Compare each step with its `source`, and answer the `questions`.
`pcmrs fsm design` makes the workflow; no daemon runs it until `pcmrs fsm approve`."""


@dataclass(frozen=True, slots=True)
class DraftRound:
    """One answer of the model, and what is wrong with it.

    Attributes:
        table: The step table; None if the answer is none.
        findings: What is wrong, in words; empty if the workflow is proved.
    """

    table: StepTable | None
    findings: list[str]


@dataclass(frozen=True, slots=True)
class Draft:
    """Result of drafting.

    Attributes:
        text: The step table as TOML, with its provenance; if it is unsound, with its findings in `unresolved`, so that
            no workflow is designed from it. Empty if no answer was a table.
        blueprint: The proved workflow as TOML; empty if it is unsound.
        table: The step table; None if no answer was one.
        findings: What is wrong with the last answer, in words; empty if the workflow is proved.
        rounds: All rounds.
    """

    text: str
    blueprint: str
    table: StepTable | None
    findings: list[str]
    rounds: list[DraftRound]


async def draft(
    protocol: str,
    client: ModelClient,
    date: str,
    *,
    most_rounds: int = MOST_ROUNDS,
    report: Callable[[int, DraftRound], object] = lambda _number, _round: None,
) -> Draft:
    """Draft the step table of a protocol.

    Args:
        protocol: Text of the protocol.
        client: Client of the model.
        date: Date of today, UTC, as ``2026-11-27``.
        most_rounds: Limit of rounds.
        report: Called after each round with its number and result.

    Raises:
        ModelError: The model gives no usable answer.
    """
    first = first_messages(protocol)
    provenance = ProvenanceSpec(
        model=client.settings.model, prompt=prompt_hash(first), protocol=hash_of(protocol), date=date
    )
    messages, best, rounds = first, ExaminedAnswer(), list[DraftRound]()
    for number in range(1, most_rounds + 1):
        answer = await client.ask(messages, answer_schema())
        examined = examine_answer(answer.text, protocol, provenance, complete=answer.complete)
        words = [in_words(finding, examined.table) for finding in examined.findings]
        rounds.append(DraftRound(examined.table, words))
        report(number, rounds[-1])
        if examined.table is not None:
            best = examined
        if not words:
            break
        messages = next_messages(first, answer.text, words[:MOST_FINDINGS])
    return _result(best, rounds)


def _result(best: ExaminedAnswer, rounds: list[DraftRound]) -> Draft:
    """Return the last table, with its own findings: a later answer may have been no table at all."""
    if best.table is None:
        return Draft("", "", None, rounds[-1].findings, rounds)
    findings = [in_words(finding, best.table) for finding in best.findings]
    questions = [*best.table.questions, *questions_about(best.table)]
    table = msgspec.structs.replace(best.table, questions=questions, unresolved=findings)
    return Draft(table_text(table, HEAD), best.blueprint, table, findings, rounds)
