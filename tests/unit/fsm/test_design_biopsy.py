"""The biopsy of five steps in `examples`: what reaches the patient is barred, confirmed, done once, and made safe."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.authoring.design import design
from pcmrs.cli import main
from pcmrs.fsm import Closure, Denial, Engine, parse_blueprint
from tests import ROOT

TABLE = ROOT / "examples/biopsy_steps.toml"
DECLARATION = re.compile(r"^(moves|affects_patient|irreversible|confirm) = .*\n", re.MULTILINE)
UNDECLARED = DECLARATION.sub("", TABLE.read_text())
WAY_IN = ["robot.connect", "procedure.register", "procedure.plan_path", "procedure.align"]
INSERTION = ["insert_confirmation.confirm_insert", "procedure.insert"]


@pytest.fixture
def cell() -> Engine:
    return Engine(parse_blueprint(design(TABLE.read_bytes()).text.encode()))


def perform(cell: Engine, *commands: str) -> None:
    for command in commands:
        cell.perform(*command.split("."))


def is_accepted(cell: Engine, command: str) -> bool:
    return isinstance(cell.ask(*command.split(".")), Closure)


def test_stop_bars_patient_contact_and_one_operation_unlatches(cell: Engine) -> None:
    operations = cell.blueprint.branches["procedure"].operations
    barred = {name for name, operation in operations.items() if operation.blocked_when_latched}
    assert barred == {"align", "insert", "take_sample", "allow_insert_again", "allow_take_sample_again"}
    assert cell.blueprint.unlatching == ["safety.acknowledge"]


def test_after_the_sample_nothing_starts_again_by_itself(cell: Engine) -> None:
    perform(cell, *WAY_IN, *INSERTION, "procedure.take_sample")
    for refused in ("register", "plan_path", "align", "insert", "take_sample", "reinit", "withdraw_guide"):
        assert not is_accepted(cell, f"procedure.{refused}"), refused
    perform(cell, "procedure.make_safe")
    assert not is_accepted(cell, "procedure.reinit")
    perform(cell, "procedure.register", "procedure.align")
    answer = cell.ask("procedure", "insert")
    assert isinstance(answer, Denial)
    perform(cell, "procedure.allow_insert_again", *INSERTION)
    assert not is_accepted(cell, "procedure.take_sample")


def test_once_all_is_allowed_again_the_procedure_can_begin_again(cell: Engine) -> None:
    perform(cell, *WAY_IN, *INSERTION, "procedure.take_sample", "procedure.make_safe")
    perform(cell, "procedure.allow_insert_again", "procedure.allow_take_sample_again", "procedure.reinit")
    assert cell.joint()["procedure"] == cell.blueprint.branches["procedure"].start


def test_robot_lost_at_the_patient_must_first_be_made_safe(cell: Engine) -> None:
    perform(cell, *WAY_IN, "robot.link_lost", "robot.connect")
    assert not is_accepted(cell, "procedure.align")
    assert not is_accepted(cell, "robot.connect")
    perform(cell, "procedure.make_safe", "procedure.align")


def test_the_robot_is_not_disconnected_at_the_patient(cell: Engine) -> None:
    perform(cell, *WAY_IN)
    answer = cell.ask("robot", "disconnect")
    assert isinstance(answer, Denial)
    assert answer.code == "tool_near_patient"


def test_undeclared_steps_are_refused_if_there_is_no_terminal(tmp_path: Path) -> None:
    """The refusal names what to add."""
    table = tmp_path / "steps.toml"
    table.write_text(UNDECLARED)
    result = CliRunner().invoke(main, ["fsm", "design", str(table)])
    assert (result.exit_code, result.stdout) == (1, "")
    lines = [line for line in result.stderr.splitlines() if "step_undeclared" in line]
    assert len(lines) == 5
    assert all(key in lines[2] for key in ("align", "`moves`", "`affects_patient`", "`irreversible`", "`confirm`"))


def test_at_a_terminal_it_asks(tmp_path: Path) -> None:
    """The answers that the table of the examples gives make the same blueprint."""
    table, made = tmp_path / "steps.toml", tmp_path / "made.toml"
    table.write_text(UNDECLARED)
    answers = "nnnn nnnn ynnn nyyy nyyn".replace(" ", "")
    command = [sys.executable, "-m", "pcmrs.cli", "fsm", "design", str(table), "-o", str(made)]
    ours, theirs = pty.openpty()
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        os.close(theirs)
        os.write(ours, "".join(f"{answer}\n" for answer in answers).encode())
        _, said = process.communicate(timeout=60)
        os.close(ours)
    assert process.returncode == 0, said
    assert "affects_patient = true, irreversible = true, confirm = true" in said.decode()
    assert parse_blueprint(made.read_bytes()).hash == parse_blueprint(design(TABLE.read_bytes()).text.encode()).hash
