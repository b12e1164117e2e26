"""What fuzzing has started from and found: every file is taken or refused as its parser promises."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from fuzz.running import CORPUS, replay

INPUTS = sorted(CORPUS.glob("*/*"))


@pytest.mark.parametrize("path", INPUTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_an_input_is_taken_or_refused(path: Path) -> None:
    replay(import_module(f"fuzz.{path.parent.name}").one, path.read_bytes())


def test_every_target_has_a_corpus() -> None:
    targets = {path.stem for path in CORPUS.parent.glob("*.py")} - {"__init__", "running"}
    assert targets == {path.parent.name for path in INPUTS}
