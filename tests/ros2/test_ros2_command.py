"""`pcmrs ros2` where it cannot do what it should: one readable line, and the exit status that it promises."""

from __future__ import annotations

import subprocess
import sys
import textwrap

from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.experiment.process import free_port

WITHOUT_PACKAGE = """
import sys
sys.modules["pycdr2"] = None
from pcmrs.cli import main
main(["ros2"])
"""


def test_a_missing_package_is_named_with_what_brings_it() -> None:
    command = [sys.executable, "-c", textwrap.dedent(WITHOUT_PACKAGE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 4
    assert "pycdr2" in done.stderr
    assert "pip install pcmrs[ros2]" in done.stderr
    assert "Traceback" not in done.stderr


def test_without_a_daemon_it_says_so() -> None:
    done = CliRunner().invoke(main, ["ros2", "--set", f"cell.endpoint=tcp/127.0.0.1:{free_port()}"])
    assert done.exit_code == 3
    assert "No daemon answers" in done.stderr
