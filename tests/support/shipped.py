"""Workflows of the product, each read once. Nothing is verified here: their tests do that."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pcmrs
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.load import read_blueprint

FOLDER = Path(pcmrs.__file__).parent / "workflows"
NAMES = sorted(path.stem for path in FOLDER.glob("*.toml"))


@cache
def shipped(name: str) -> Blueprint:
    """Return a workflow by its name, sound or not."""
    file = FOLDER / f"{name}.toml"
    blueprint, findings = read_blueprint(file.read_bytes(), file.name, FOLDER)
    assert blueprint is not None, findings
    return blueprint
