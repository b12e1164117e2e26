"""Workflows: their blueprints, and the operations that blueprints name.

This module only finds and reads blueprints. `opening` makes a workflow ready to run and loads everything that its
operations need.
"""

from __future__ import annotations

from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.load import as_written
from pcmrs.workflows.find import WorkflowFiles, find_workflow

__all__ = ["WorkflowFiles", "find_workflow", "read_workflow"]


def read_workflow(name: str) -> Blueprint:
    """Return the blueprint of a workflow as it is written, neither verified nor run.

    Args:
        name: Name of the workflow, or path of its blueprint.

    Raises:
        ConfigurationError: The workflow does not exist, or its file cannot be opened.
        BlueprintError: The file is not a blueprint.
    """
    place = find_workflow(name)
    try:
        return as_written(place.blueprint)
    except OSError as error:
        text = f"{place.blueprint} cannot be read: {error.strerror}."
        raise ConfigurationError(text, file=str(place.blueprint)) from None
