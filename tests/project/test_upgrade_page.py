"""The page on upgrades and backups: what its blocks show happens, on the lab of the first version."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.system.daemon.shell_pages import ShownPage
from tests.unit.maintenance.labs import unpacked

PAGE = ROOT / "docs" / "upgrade.md"


@pytest.mark.timeout(300)
def test_the_blocks_of_the_page_do_what_they_show(tmp_path: Path) -> None:
    unpacked("first", tmp_path)
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": "200",
    }
    shown = [each for each in ShownPage(PAGE).commands() if each.output is not None]
    assert len(shown) >= 7
    for each in shown:
        words = [sys.executable, "-m", "pcmrs.cli", *each.command.split()[1:]]
        ended = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, f"$ {each.command}\n{ended.stderr}"
        assert each.matches(ended.stdout), f"$ {each.command}\n{ended.stdout}"
