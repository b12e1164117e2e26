"""Files that `pcmrs fsm` reads and writes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.cli.command_line import run


def test_name_means_the_installed_workflow_not_a_local_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is verified is what a daemon would run."""
    (tmp_path / "ratms").write_text("not a blueprint")
    monkeypatch.chdir(tmp_path)
    assert run("fsm", "verify", "ratms").exit_code == 0
    assert run("fsm", "verify", "./ratms").exit_code == 2
