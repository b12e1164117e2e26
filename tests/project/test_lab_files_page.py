"""The example on the page about the lab's files does what it shows."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from tests import ROOT
from tests.system.daemon.shell_pages import ShownPage


def test_the_example_of_the_page_does_what_it_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    shown = list(ShownPage(ROOT / "docs" / "lab-files.md").commands())
    assert len(shown) == 3
    for command in shown:
        program, *words = shlex.split(command.command)
        assert program == "pcmrs"
        ended = CliRunner().invoke(main, words)
        assert ended.exit_code == 0, ended.stderr
        assert command.matches(ended.stdout), ended.stdout
