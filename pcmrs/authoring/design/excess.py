"""What to say when the steps would make a blueprint that is too large to be read or verified."""

from __future__ import annotations

from collections.abc import Sequence

from pcmrs.authoring.design.branches import Designed
from pcmrs.fsm.blueprint import BranchSpec
from pcmrs.fsm.files.bounded import MAX_BYTES
from pcmrs.fsm.files.load import Examination
from pcmrs.fsm.finding import Finding


def excess_of(examination: Examination, size: int, branches: Sequence[Designed]) -> Finding | None:
    """The finding for the table, at the step that makes the largest branch, or at its points; None where none is due.

    Args:
        examination: Of the blueprint.
        size: Of the blueprint, in bytes.
        branches: Of the blueprint.
    """
    if examination.readable and all(finding.code != "too_many_states" for finding in examination.findings):
        return None
    why = f"The blueprint would have {size} bytes; the limit is {MAX_BYTES}."
    why = examination.findings[0].text if size <= MAX_BYTES else why
    largest = max(branches, key=lambda branch: _size(branch.spec))
    points = ("refined_by", "points") if largest.spec.sequence else ()
    text = f"{why} Most is from {largest.name}, with {_size(largest.spec)} {'points' if points else 'states'}."
    return Finding(code="step_count", text=text, path=(*largest.path, *points))


def _size(spec: BranchSpec) -> int:
    sequence = spec.sequence
    return len(spec.states) if sequence is None else sequence.count or len(sequence.items)
