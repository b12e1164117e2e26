"""The base install on Windows and macOS, where planners and viewers run: wheels of all that it needs are there."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests import ROOT

NO_INDEX = re.compile(
    r"offline|network connectivity|client error|dns error|connection (refused|reset)|timed out|error sending request",
    re.IGNORECASE,
)
"""What uv says when it can ask no package index."""


@pytest.mark.parametrize("python", ["3.11", "3.13"])
@pytest.mark.parametrize("platform", ["windows", "macos", "linux"])
def test_wheels_of_the_base_install_are_there(platform: str, python: str) -> None:
    words = [
        "pip",
        "compile",
        "--no-python-downloads",
        "--python-platform",
        platform,
        "--python-version",
        python,
        "--only-binary",
        ":all:",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "uv", *words, "--no-header", "--no-annotate", "pyproject.toml"],
        cwd=ROOT,
        env={**os.environ, "UV_HTTP_RETRIES": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode and NO_INDEX.search(done.stderr):
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, done.stderr
    found = {line.partition("==")[0] for line in done.stdout.splitlines()}
    assert {"eclipse-zenoh", "msgspec", "numpy"} <= found
    assert not found & {"matplotlib", "pin", "plutoprint", "resvg-py", "tree-sitter", "uvloop"}
