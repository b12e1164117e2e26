"""`pcmrs fsm generate` prints the code that a daemon executes, and nothing for an unsound workflow."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from pcmrs.fsm import load_blueprint
from pcmrs.fsm.classes import source_of
from pcmrs.workflows import find_workflow
from tests.unit.cli.command_line import run


@pytest.mark.parametrize("workflow", ["ratms", "femoroplasty"])
def test_what_is_printed_is_what_a_daemon_executes(workflow: str, tmp_path: Path) -> None:
    printed = run("fsm", "generate", workflow)
    assert printed.exit_code == 0, printed.stderr
    assert printed.stdout == source_of(load_blueprint(find_workflow(workflow).blueprint))
    assert any(isinstance(node, ast.ClassDef) for node in ast.parse(printed.stdout).body)
    assert run("fsm", "generate", workflow, "-o", str(tmp_path / "states.py")).stdout == ""
    assert (tmp_path / "states.py").read_text() == printed.stdout


def test_of_an_unsound_workflow_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('schema = 1\nid = "own"\n')
    ended = run("fsm", "generate", str(tmp_path / "own.toml"), "-o", str(tmp_path / "states.py"))
    assert ended.exit_code in (1, 2)
    assert "own.toml" in ended.stderr
    assert not (tmp_path / "states.py").exists()
