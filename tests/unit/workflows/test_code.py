"""A workflow's Python file: it is run only to be used, and its faults are reported with their line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import BlueprintError, ConfigurationError
from pcmrs.settings import read_settings
from pcmrs.workflows.opening import open_workflow
from tests.unit.workflows.lamp_workflow import STRIKE, write_workflow


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("def register(registry:\n", ("lamp.py, line 1", "SyntaxError")),
        ("import nothing_of_this_name\n", ("lamp.py, line 1", "nothing_of_this_name")),
        ("x = 1\n\ny = x / 0\n", ("lamp.py, line 3", "ZeroDivisionError")),
        ("import sys\nsys.exit('no')\n", ("lamp.py, line 2", "SystemExit")),
        ("register = 5\n", ("lamp.py", "register(registry)")),
        ("", ("lamp.py", "register(registry)")),
        ("def register(registry):\n    registry.stap(1)\n", ("lamp.py, line 2", "stap")),
        ("def register(registry):\n    pass\n", ("lamp.toml", "lamp.light", "step", "'strike'", "lamp.py")),
        (None, ("lamp.toml", "lamp.light", "step", "'strike'", "lamp.py")),
        (STRIKE + "    registry.steps['keep_plan'] = strike\n", ("lamp.py", "'keep_plan'", "another name")),
        (STRIKE + "    registry.payload('landmarks', Data)\n", ("lamp.py", "'landmarks'", "another name")),
        ("Data = dict\n\ndef register(registry): ...\n", ("lamp.py", "Data", "PlacementData")),
        ("settle = None\n\ndef register(registry): ...\n", ("lamp.py", "settle(data, states, effects)")),
        (
            STRIKE.replace("strikes: int = 0", "@classmethod\n    def begin(cls, _): return 1 / 0"),
            ("line 6", "ZeroDiv"),
        ),
        ("async def strike(run): ...\ndef register(registry):\n    registry.step(strike)\n", ("line 3", "world_step")),
    ],
)
def test_faulty_python_file_is_reported_with_its_line(tmp_path: Path, code: str | None, words: Sequence[str]) -> None:
    file = write_workflow(tmp_path, code=code)
    with pytest.raises((ConfigurationError, BlueprintError)) as refused:
        open_workflow(str(file))
    for word in words:
        assert word in refused.value.text


def test_reading_and_verifying_do_not_run_the_python_file(tmp_path: Path) -> None:
    file = write_workflow(tmp_path, code="raise RuntimeError('was run')\n")
    verified = CliRunner().invoke(main, ["fsm", "verify", str(file)])
    assert verified.exit_code == 0, verified.output
    assert read_settings(None, [f"workflow={file}"]).workflow == str(file)
    with pytest.raises(ConfigurationError, match="was run"):
        open_workflow(str(file))
