"""Workflows for tests: not verified, which takes seconds, and those of this repository opened once for each worker.

Nobody writes to a workflow. `tests/unit/workflows/test_opening.py` verifies those of this repository.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
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
    """Return the blueprint of a workflow as a daemon has it. It is quick enough for a constant of a test module."""
    return unverified_blueprint(find_workflow(name).blueprint)


@cache
def shipped_workflow(name: str) -> Workflow[Cell, PlacementData]:
    """Return a workflow ready to run."""
    return _opened(name, shipped_blueprint(name))


def unverified_blueprint(path: Path) -> Blueprint:
    """Return the blueprint in a file as a daemon has it."""
    blueprint, findings = read_blueprint(path.read_bytes(), str(path), path.parent)
    assert blueprint is not None, findings
    return blueprint


def unverified_workflow(path: Path) -> Workflow[Cell, PlacementData]:
    """Return the workflow of a blueprint file ready to run."""
    return _opened(str(path), unverified_blueprint(path))


def _opened(name: str, blueprint: Blueprint) -> Workflow[Cell, PlacementData]:
    # Imported here, because it loads all that operations need, and most tests of a blueprint need nothing of that.
    from pcmrs.workflows.opening import open_verified

    workflow = open_verified(name, blueprint)
    registry = workflow.registry
    frozen: Any = {"checks": MappingProxyType(registry.checks), "steps": MappingProxyType(registry.steps)}
    return replace(workflow, registry=replace(registry, **frozen))
