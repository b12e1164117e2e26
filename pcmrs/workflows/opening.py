"""Workflows ready to run: a blueprint with its checks and steps."""

from __future__ import annotations

import logging
from typing import Any

from pcmrs.dispatcher import Registry, Workflow
from pcmrs.errors import BlueprintError, ConfigurationError
from pcmrs.fsm import Blueprint, load_blueprint
from pcmrs.workflows._alignment import register_alignment
from pcmrs.workflows._code import WorkflowCode, add_source_location, load_code
from pcmrs.workflows._connection import register_connection_operations
from pcmrs.workflows._contact import register_contact_operations
from pcmrs.workflows._correction import register_correction_steps
from pcmrs.workflows._following import register_following
from pcmrs.workflows._landmarks import register_landmark_operations
from pcmrs.workflows._motion import register_motion_steps
from pcmrs.workflows._placement import register_placement_checks
from pcmrs.workflows._refinement import register_refinement_operations
from pcmrs.workflows._registering import register_registration_operations
from pcmrs.workflows._teleoperation import register_teleoperation
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.find import WorkflowFiles, find_installed, find_workflow
from pcmrs.workflows.reference import register_reference_operations
from pcmrs.workflows.toolplan import register_plan_operations

__all__ = ["open_installed", "open_verified", "open_workflow", "placement_registry"]

_log = logging.getLogger(__name__)


def open_workflow(name: str) -> Workflow[Cell, PlacementData]:
    """Return a workflow ready to run: its blueprint is verified, and its Python file has run.

    Args:
        name: Name of the workflow, or path of its blueprint.

    Raises:
        ConfigurationError: The workflow does not exist, or its Python file is faulty.
        BlueprintError: Its blueprint is unsound, or uses a name that is not registered.
    """
    return _open(find_workflow(name))


def open_verified(name: str, blueprint: Blueprint) -> Workflow[Cell, PlacementData]:
    """Return a workflow whose blueprint this process has from the one that has read and verified it.

    Args:
        name: Name of the workflow, or path of its blueprint; its Python file is run.
        blueprint: The blueprint.

    Raises:
        ConfigurationError: The workflow does not exist, or its Python file is faulty.
        BlueprintError: The blueprint uses a name that is not registered.
    """
    return _complete(find_workflow(name), blueprint)


def open_installed(name: str) -> Workflow[Cell, PlacementData]:
    """Return an installed workflow ready to run.

    For names from elsewhere, such as another machine's journal, which must not be paths.

    Args:
        name: Name of the workflow.

    Raises:
        ConfigurationError: The workflow does not exist, or its Python file is faulty.
        BlueprintError: Its blueprint is unsound, or uses a name that is not registered.
    """
    return _open(find_installed(name))


def _open(files: WorkflowFiles) -> Workflow[Cell, PlacementData]:
    return _complete(files, load_blueprint(files.blueprint, warn=lambda warning: _log.warning("%s", warning.heading)))


def _complete(files: WorkflowFiles, blueprint: Blueprint) -> Workflow[Cell, PlacementData]:
    code = load_code(files)
    registry = _registry_with(files, code)
    initial = add_source_location(files.code, code.data.begin, blueprint)
    try:
        return Workflow(blueprint, registry, initial, code.settle)
    except BlueprintError as error:
        if "findings" in error.fields:
            raise BlueprintError(f"{files.blueprint}: {error.text}", **error.fields) from None
        text = f"{files.blueprint}: {error.text}; neither PCMRS nor {files.code} registers this name."
        raise BlueprintError(text, **error.fields) from None


def _registry_with(files: WorkflowFiles, code: WorkflowCode) -> Registry[Cell, PlacementData]:
    """Return the shared registry with the workflow's additions. A workflow cannot redefine a shared name."""
    shared, registry = placement_registry(), placement_registry()
    add_source_location(files.code, code.register, registry)
    kinds: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (shared.payloads, registry.payloads),
        (shared.checks, registry.checks),
        (shared.steps, registry.steps),
        (shared.activities, registry.activities),
    ]
    for before, after in kinds:
        for name in before:
            if after[name] is not before[name]:
                text = f"{files.code}: registers {name!r}, which PCMRS has already: give it another name."
                raise ConfigurationError(text, file=str(files.code), name=name)
    return registry


def placement_registry() -> Registry[Cell, PlacementData]:
    """Return the registry of checks and steps of the procedures that place a tool on a registered body."""
    registry: Registry[Cell, PlacementData] = Registry()
    register_landmark_operations(registry)
    register_registration_operations(registry)
    register_refinement_operations(registry)
    register_reference_operations(registry)
    register_plan_operations(registry)
    register_connection_operations(registry)
    register_placement_checks(registry)
    register_motion_steps(registry)
    register_correction_steps(registry)
    register_alignment(registry)
    register_following(registry)
    register_teleoperation(registry)
    register_contact_operations(registry)
    return registry
