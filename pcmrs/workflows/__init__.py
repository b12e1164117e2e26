"""Procedures: a blueprint each, and the operations that blueprints name.

What is here reads them only; `opening` makes one ready to run, and loads all that operations compute with.
"""

from __future__ import annotations

from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.load import load_unexpanded
from pcmrs.workflows.find import Place, find_workflow

__all__ = ["Place", "find_workflow", "read_workflow"]


def read_workflow(name: str) -> Blueprint:
    """The blueprint of the workflow of that name or path, as it is written: neither verified nor run.

    Raises:
        ConfigurationError: There is no such workflow, or its file cannot be opened.
        BlueprintError: It is no blueprint.
    """
    place = find_workflow(name)
    try:
        return load_unexpanded(place.blueprint)
    except OSError as error:
        text = f"{place.blueprint} cannot be read: {error.strerror}."
        raise ConfigurationError(text, file=str(place.blueprint)) from None
