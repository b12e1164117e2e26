"""What fuzzing has started from and found: every file is taken or refused as its parser promises."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from fuzz.running import CORPUS, feed

INPUTS = sorted(CORPUS.glob("*/*"))
TARGETS = sorted({path.stem for path in CORPUS.parent.glob("*.py")} - {"__init__", "running"})

SECONDS = 1600
"""Time for all targets together. Two of them run at once: the nightly part `fuzz` may take 16 minutes, s."""


@pytest.mark.parametrize("path", INPUTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_an_input_is_taken_or_refused(path: Path) -> None:
    feed(import_module(f"fuzz.{path.parent.name}").one, path.read_bytes())


def test_every_target_has_a_corpus() -> None:
    assert sorted({path.parent.name for path in INPUTS}) == TARGETS


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris has no wheel for this platform")
@pytest.mark.parametrize("target", TARGETS)
def test_new_inputs_are_taken_or_refused(target: str) -> None:
    words = [sys.executable, "-m", f"fuzz.{target}", f"-max_total_time={SECONDS // len(TARGETS)}"]
    ended = subprocess.run(words, cwd=CORPUS.parents[1], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr[-4000:]
    assert "Task was destroyed" not in ended.stderr
