"""Findings in the words that a model, or the author of a protocol, can act on."""

from __future__ import annotations

from pcmrs.authoring.design.tables import StepTable
from pcmrs.fsm.finding import Finding, Path


def in_words(finding: Finding, table: StepTable | None) -> str:
    """Return a finding with the step or requirement that it is about, and the commands that show it.

    Args:
        finding: The finding.
        table: The table; None if the answer was none.
    """
    place = "" if table is None else _place(finding.path, table)
    text = f"{place}{finding.code}: {finding.text}"
    if finding.commands:
        shown = ", ".join(f"{number}. {command}" for number, command in enumerate(finding.commands, 1))
        text += f" These commands, one after the other, show it: {shown}."
    return text


def _place(path: Path, table: StepTable) -> str:
    """Return the name of the step or requirement that a path leads to; steps of refinements by the step above."""
    if len(path) > 1 and path[0] == "steps" and path[1].isdecimal():
        return f"step {table.steps[int(path[1])].name}: "
    if len(path) > 1 and path[0] == "requirements" and path[1].isdecimal():
        return f"requirement {table.requirements[int(path[1])].id}: "
    return ""
