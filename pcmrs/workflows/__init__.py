"""Procedures: a blueprint each, and the operations that blueprints name."""

from __future__ import annotations

from pathlib import Path

from pcmrs.dispatcher import Registry, Workflow
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import load_blueprint
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.connection import register_connection_operations
from pcmrs.workflows.data import PlacementData, settle
from pcmrs.workflows.landmarks import register_landmark_operations
from pcmrs.workflows.motion import register_motion_steps
from pcmrs.workflows.placement import register_placement_checks
from pcmrs.workflows.toolplan import register_plan_operations

FOLDER = Path(__file__).parent


def open_workflow(name: str) -> Workflow[Cell, PlacementData]:
    """The workflow of that name, ready to run.

    Raises:
        ConfigurationError: There is no such workflow.
        BlueprintError: Its blueprint is unsound.
    """
    path = FOLDER / f"{name}.toml"
    known = sorted(file.stem for file in FOLDER.glob("*.toml"))
    if name not in known:
        raise ConfigurationError(f"There is no workflow {name!r}; there are {', '.join(known)}.", workflow=name)
    return Workflow(load_blueprint(path), placement_registry(), PlacementData(), settle)


def placement_registry() -> Registry[Cell, PlacementData]:
    """Checks and steps of the procedures that place a tool on a registered body."""
    registry: Registry[Cell, PlacementData] = Registry()
    register_landmark_operations(registry)
    register_plan_operations(registry)
    register_connection_operations(registry)
    register_placement_checks(registry)
    register_motion_steps(registry)
    return registry
