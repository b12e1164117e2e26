"""Step tables for tests: those of the examples, and some that are written in a line."""

from __future__ import annotations

import tomllib
from typing import Any

import msgspec
import tomli_w

from pcmrs.authoring.design import design
from pcmrs.authoring.design._check import paths_of
from pcmrs.authoring.design._grouping import StepGroup, root_groups
from pcmrs.authoring.design.tables import StepTable
from pcmrs.fsm import Blueprint, parse_blueprint
from pcmrs.fsm.finding import Path
from tests import ROOT

EXAMPLES = ROOT / "examples"

RATMS_STEPS = (EXAMPLES / "ratms_steps.toml").read_bytes()
GRID_STEPS = (EXAMPLES / "grid_steps.toml").read_bytes()
HEEDED = {"safety": "watched"}
"""State of the branch that releases Stop, where a table has steps that it bars."""


def blueprint_of(raw: bytes) -> Blueprint:
    result = design(raw, origin="steps.toml")
    assert not result.findings, [str(finding) for finding in result.findings]
    return parse_blueprint(result.text.encode())


def table(*steps: dict[str, Any], **keys: Any) -> bytes:
    return tomli_w.dumps({"id": "demo", "version": "1", "steps": [step("a") | each for each in steps], **keys}).encode()


def step(name: str, *needs: str, **keys: Any) -> dict[str, Any]:
    return {"name": name, "operation": f"do_{name}", "depends_on": list(needs)} | declared(keys)


def declared(keys: dict[str, Any]) -> dict[str, Any]:
    """The keys, with a declaration unless they have one or the step is done by the steps that refine it."""
    return keys if "steps" in keys.get("refined_by", {}) else {"moves": False} | keys


def converted(*steps: dict[str, Any]) -> tuple[list[StepGroup], dict[str, Path]]:
    """Return the branches of a table, and the path of each step."""
    read = msgspec.convert(tomllib.loads(table(*steps).decode()), StepTable)
    paths = {each.name: path for path, each in paths_of(read.steps)}
    return root_groups(read.steps, paths), paths
