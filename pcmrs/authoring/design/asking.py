"""Asks for what a step table leaves open: what its actions do to the patient."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from pcmrs.authoring.design.check import undeclared
from pcmrs.authoring.design.table import DECLARATIONS, StepTable

Ask = Callable[[str], Collection[str]]
"""Gets the name of an operation, returns those of `DECLARATIONS` that are true of it."""


def answer(content: dict[str, Any], table: StepTable, ask: Ask) -> None:
    """Write the answers into a table as it was read.

    Args:
        content: The file's content; changed.
        table: The same, converted.
        ask: Asked once for each action that says nothing.
    """
    for path, operation, _ in undeclared(table):
        true = ask(operation)
        place: Any = content
        for key in path:
            place = place[int(key)] if isinstance(place, list) else place[key]
        place |= {key: key in true for key in DECLARATIONS}
