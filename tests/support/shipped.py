"""The workflows of this repository, opened once for all tests of a worker: nobody writes to them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.workflows import find_workflow
from pcmrs.workflows.find import FOLDER

if TYPE_CHECKING:
    from pcmrs.dispatcher import Workflow
    from pcmrs.workflows.cell import Cell
    from pcmrs.workflows.data import PlacementData


NAMES = sorted(path.stem for path in FOLDER.glob("*.toml"))


@cache
def shipped_blueprint(name: str) -> Blueprint:
    """Return the blueprint of a workflow as a daemon has it, but not verified, which takes seconds.

    It is quick enough for a constant of a test module.
    """
    path = find_workflow(name).blueprint
    blueprint, findings = read_blueprint(path.read_bytes(), str(path), path.parent)
    assert blueprint is not None, findings
    return blueprint


@cache
def shipped_workflow(name: str) -> Workflow[Cell, PlacementData]:
    """Return a workflow ready to run; `test_shipped_workflows_are_sound` verifies its blueprint.

    It loads all that operations need: call it in a test or a fixture.
    """
    # Imported here, because it loads all that operations need, and most tests of a blueprint need nothing of that.
    from pcmrs.workflows.opening import open_verified

    workflow = open_verified(name, shipped_blueprint(name))
    registry = workflow.registry
    frozen: Any = {"checks": MappingProxyType(registry.checks), "steps": MappingProxyType(registry.steps)}
    return replace(workflow, registry=replace(registry, **frozen))
