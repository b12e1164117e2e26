"""`pcmrs fsm generate` prints the code that a daemon executes, and nothing for an unsound workflow."""

from __future__ import annotations

import ast
from pathlib import Path

from pcmrs.fsm.classes import source_of
from tests.support.shipped import shipped_blueprint
from tests.unit.cli.command_line import run


def test_what_is_printed_is_what_a_daemon_executes(tmp_path: Path) -> None:
    expected = source_of(shipped_blueprint("ratms"))
    printed = run("fsm", "generate", "ratms")
    assert (printed.exit_code, printed.stdout) == (0, expected), printed.stderr
    assert any(isinstance(node, ast.ClassDef) for node in ast.parse(expected).body)
    written = run("fsm", "generate", "ratms", "-o", str(tmp_path / "states.py"))
    assert (written.exit_code, written.stdout) == (0, "")
    assert (tmp_path / "states.py").read_text() == expected


def test_of_an_unsound_workflow_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('schema = 1\nid = "own"\n')
    ended = run("fsm", "generate", str(tmp_path / "own.toml"), "-o", str(tmp_path / "states.py"))
    assert ended.exit_code in (1, 5)
    assert "own.toml" in ended.stderr
    assert not (tmp_path / "states.py").exists()
