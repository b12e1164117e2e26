"""A workflow of a user: a lamp that is lit by a step of its own file."""

from __future__ import annotations

from pathlib import Path

LAMP = """
id = "lamp"
version = "1"
branches.lamp.states = { off = "dark", on = "lit" }
branches.lamp.operations.light = { from = ["off"], to = "on", steps = ["strike"] }
branches.lamp.operations.quench = { from = ["on"], to = "off" }
"""
STRIKE = """
from pcmrs.workflows.data import PlacementData

class Data(PlacementData, frozen=True, kw_only=True):
    strikes: int = 0

def strike(run):
    run.keep(strikes=run.data.strikes + 1)

def settle(data, states, effects):
    return data if states["lamp"] == "on" else type(data)()

def register(registry):
    registry.step(strike)
"""


def write_workflow(folder: Path, toml: str = LAMP, code: str | None = STRIKE) -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    file = folder / "lamp.toml"
    file.write_text(toml)
    if code is not None:
        file.with_suffix(".py").write_text(code)
    return file
