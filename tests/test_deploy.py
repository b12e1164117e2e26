"""The systemd unit is one that systemd understands, and fits the daemon."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.cli.running import EXIT_BAD_CONFIGURATION
from pcmrs.settings import CellSettings

UNIT = Path(__file__).parents[1] / "deploy" / "pcmrs.service"
INSTALLED = "/opt/pcmrs/bin/pcmrs-serve"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_finds_nothing_to_say_about_the_unit(tmp_path: Path) -> None:
    text = UNIT.read_text()
    assert INSTALLED in text
    here = tmp_path / UNIT.name
    here.write_text(text.replace(INSTALLED, sys.executable))
    told = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", here],
        capture_output=True,
        text=True,
        check=False,
    )
    # It ends with 0 on a misspelt key, too, and says so on standard error only.
    assert (told.stdout, told.stderr, told.returncode) == ("", "", 0)


def test_the_unit_fits_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = dict(re.findall(r"^(\w+)=(.*)$", UNIT.read_text(), re.MULTILINE))
    assert settings["RestartPreventExitStatus"] == str(EXIT_BAD_CONFIGURATION)
    monkeypatch.setenv("XDG_STATE_HOME", "/var/lib")  # what the unit sets: %S
    assert CellSettings().path().is_relative_to(Path("/var/lib") / settings["StateDirectory"])
