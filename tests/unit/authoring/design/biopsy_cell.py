"""The workflow that is designed from the biopsy of the examples."""

from __future__ import annotations

from pcmrs.authoring.design import design
from pcmrs.fsm import Closure, Engine, parse_blueprint
from tests import ROOT

TABLE = ROOT / "examples/biopsy_steps.toml"

WAY_IN = ["robot.connect", "procedure.register", "procedure.plan_path", "procedure.align"]
INSERTION = ["insert_confirmation.confirm_insert", "procedure.insert"]


def biopsy_cell() -> Engine:
    return Engine(parse_blueprint(design(TABLE.read_bytes()).text.encode()))


def perform(cell: Engine, *commands: str) -> None:
    for command in commands:
        cell.perform(*command.split("."))


def is_accepted(cell: Engine, command: str) -> bool:
    return isinstance(cell.ask(*command.split(".")), Closure)
