"""`pcmrs fsm design`: what it writes, and how it ends."""

from __future__ import annotations

import json
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
from pcmrs.cli.fsm.design import design as command
from pcmrs.fsm import load_blueprint, parse_blueprint
from tests.unit.authoring.design.biopsy_cell import TABLE
from tests.unit.authoring.design.step_tables import EXAMPLES, RATMS_STEPS, step, table


def test_command_writes_the_blueprint_and_counts_combinations(tmp_path: Path) -> None:
    """It reports how many combinations of steps are possible."""
    output = tmp_path / "blueprint.toml"
    result = CliRunner().invoke(command, [str(EXAMPLES / "ratms_steps.toml"), "-o", str(output)])
    assert result.exit_code == 0
    assert result.stdout.startswith("8 of the 16 combinations of 4 steps are possible.")
    assert load_blueprint(output).id == "ratms_steps"


def test_command_writes_only_the_blueprint_to_standard_output() -> None:
    result = CliRunner().invoke(command, ["-"], input=RATMS_STEPS)
    assert result.exit_code == 0
    assert parse_blueprint(result.stdout.encode()).id == "ratms_steps"
    assert result.stderr.startswith("8 of the 16")


@pytest.mark.parametrize(("raw", "status"), [(table(step("a", "b")), 1), (b"no table", 5), (b'id = "x"', 5)])
def test_the_command_ends_with_findings(raw: bytes, status: int, tmp_path: Path) -> None:
    output = tmp_path / "blueprint.toml"
    result = CliRunner().invoke(command, ["-", "-o", str(output)], input=raw)
    assert result.exit_code == status
    assert result.stderr.startswith("<stdin>:")
    assert not output.exists()


def test_the_command_says_in_json_what_came_of_it(tmp_path: Path) -> None:
    output = tmp_path / "blueprint.toml"
    result = CliRunner().invoke(command, ["-", "--json", "-o", str(output)], input=RATMS_STEPS)
    said = json.loads(result.stdout)
    assert (result.exit_code, said["file"], said["readable"], said["sound"], said["findings"]) == (
        0, "<stdin>", True, True, [],
    )  # fmt: skip
    assert (said["combinations"]["steps"], said["combinations"]["possible"]) == (4, 8)
    assert said["combinations"]["impossible"][1] == {"step": "registered", "missing": "landmarks_digitized", "count": 4}
    assert load_blueprint(output).id == "ratms_steps"
    refused = CliRunner().invoke(command, ["-", "--json"], input=table(step("a", "b")))
    said = json.loads(refused.stdout)
    assert (refused.exit_code, said["readable"], said["sound"], said["combinations"]) == (1, True, False, None)
    assert [finding["code"] for finding in said["findings"]] == ["step_unknown"]


DECLARATION = re.compile(r"^(moves|affects_patient|irreversible|confirm) = .*\n", re.MULTILINE)
UNDECLARED = DECLARATION.sub("", TABLE.read_text())


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
