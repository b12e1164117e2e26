"""A delayed process delays its failpoints, whichever modules were imported before it was told to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from pcmrs_lab.campaign.delays import VARIABLE

CODE = """
import pcmrs.dispatcher.performer, pcmrs.journal.writer
from pcmrs_lab.campaign.delayed_process import install
install()
import pcmrs.service.publishing
from pcmrs import failpoints
modules = pcmrs.dispatcher.performer, pcmrs.journal.writer, pcmrs.service.publishing
print([module.failpoint is failpoints.failpoint for module in modules])
print(failpoints.failpoint.__name__)
"""


def test_failpoints_of_all_modules_are_delayed(tmp_path: Path) -> None:
    (tmp_path / "rules").write_text("[]")
    ran = subprocess.run(
        [sys.executable, "-c", CODE],
        env={**os.environ, VARIABLE: str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.splitlines() == ["[True, True, True]", "passed"]
