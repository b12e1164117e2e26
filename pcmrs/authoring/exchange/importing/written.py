"""The file of an imported blueprint; none where nobody could read it again."""

from __future__ import annotations

from pathlib import Path

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.bounded import MAX_BYTES
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.files.load import examine
from pcmrs.fsm.finding import Finding


def written(blueprint: Blueprint, chart: str, output: str) -> tuple[str, list[Finding]]:
    """The blueprint as text, and what is wrong with it.

    Args:
        blueprint: Imported.
        chart: The file it was imported from.
        output: How findings call the file it goes to.

    Returns:
        The text, with what makes it unsound; an empty one where it would be too large to be read, said of the chart.
    """
    text = blueprint_toml(blueprint, comment=f"Imported from {Path(chart).name}.")
    if (size := len(text.encode())) > MAX_BYTES:
        said = f"The blueprint of this chart would have {size} bytes; the limit is {MAX_BYTES}. Split the chart."
        return "", [Finding(code="too_large", text=said, file=chart, line=1, column=1)]
    return text, examine(text.encode(), origin=output).findings
