"""Checks of texts: what looks like data of a patient, like an instruction to a model, or like a missing declaration.

They find what has a usual form only. A person has to read the text.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from pcmrs.authoring.design import paths_of
from pcmrs.authoring.design.tables import StepTable

_DATE = r"(?:\d{1,2}[./-]\d{1,2}[./-](?:19|20)\d\d|(?:19|20)\d\d-\d\d-\d\d)"
PATIENT_DATA = {
    "a date of birth": rf"(?:\bborn\b|\bD\.?O\.?B\b|\bbirth\b)[^\n]{{0,30}}?{_DATE}|\*\s?{_DATE}",
    "a name with a title": r"\b(?:Mr|Mrs|Ms|Miss|Herr|Frau|Mme|Sr|Sra)\b\.?\s+[A-Z]\w+",
    "the name of a patient": r"\b[Pp]atient(?:'s)?(?: name)?\s*:\s*[A-Z]\w+,? [A-Z]\w+",
    "the number of a patient or case": r"\b(?:MRN|PID|[Pp]atient (?:ID|id|no|number)|[Cc]ase (?:no|number))\b\W*\d{3,}",
    "a number of social security": r"\b\d{3}-\d{2}-\d{4}\b",
    "an e-mail address": r"\b[\w.+-]+@[\w-]+\.[\w.]+\b",
    "a telephone number": r"(?:\+\d{1,3}[ -]?|\b0)\d{2,4}[ /-]\d{3,}[ -]?\d{2,}\b",
}
"""Patterns of data that may identify a patient."""

INSTRUCTIONS = (
    r"\b(?:ignore|disregard|forget|override)\b[^.\n]{0,40}\b(?:rules?|instructions?|above|previous|prior|prompt)\b"
    r"|\byou are (?:now|a|an)\b|\bsystem prompt\b|\bas an? (?:ai|language model)\b|<\|im_(?:start|end)\|>"
)
"""Pattern of words that speak to a model and not to people."""

ACTING = re.compile(
    r"\b(?:drill|cut|saw|mill|ream|insert|inject|punctur|pierc|incis|ablat|irradiat|puls|stimulat|punch|extract|advanc"
    r"|implant|resect|biops|coagulat|beam)\w*",
    re.IGNORECASE,
)
"""Words for what acts on a patient."""


@dataclass(frozen=True, slots=True)
class TextWarning:
    """A place in a text that a person should look at.

    Attributes:
        line: Line, from 1.
        text: What it looks like. The place itself is not repeated: messages end in logs.
    """

    line: int
    text: str


def warnings_of(protocol: str) -> list[TextWarning]:
    """Return what looks like data of a patient, and what speaks to a model, in the order of the lines."""
    found = [
        TextWarning(protocol.count("\n", 0, match.start()) + 1, f"This looks like {kind}.")
        for kind, pattern in PATIENT_DATA.items()
        for match in re.finditer(pattern, protocol)
    ]
    found += [
        TextWarning(protocol.count("\n", 0, match.start()) + 1, "This speaks to a model, not to people.")
        for match in re.finditer(INSTRUCTIONS, protocol, re.IGNORECASE)
    ]
    return sorted(found, key=lambda warning: warning.line)


def questions_about(table: StepTable) -> Iterator[str]:
    """Return questions about what a model may have left out: requirements, and effects of steps on the patient.

    Args:
        table: The table.
    """
    if not table.requirements:
        yield "There is no requirement: does the protocol promise nothing?"
    for _, step in paths_of(table.steps):
        harmless = step.refined_by is None and not (step.moves or step.affects_patient or step.irreversible)
        word = ACTING.search(f"{step.operation.replace('_', ' ')} {step.source}")
        if harmless and word is not None:
            yield f"{step.name} declares no effect on the patient, but its words have {word[0]!r}: is that right?"
