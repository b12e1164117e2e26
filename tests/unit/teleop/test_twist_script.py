"""A script in place of a device."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.teleop._twist_script import read_script
from pcmrs.teleop.demand import Demand


def test_a_script_says_when_and_ends(tmp_path: Path) -> None:
    file = tmp_path / "script.txt"
    file.write_text("# up, then rest\n0.5 0 0 0.01 0 0 0\n\n1.5 open\n2 0 0 0 0 0 0.1  # turn\n3 open\n")
    script = read_script(file)
    up, turn = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)
    asked = {100.0: Demand(), 100.6: Demand(up, clutch=True), 101.6: Demand(), 102.9: Demand(turn, clutch=True)}
    assert {now: script.demand(now) for now in asked} == asked
    assert script.demand(103.0).leave


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("0 1 2 3", "line 1"),
        ("0 open\n0 open", "line 2"),
        ("0 open\n\n1 0 0 0 0 0 nan", "line 3"),
        ("-1 open", "line 1"),
        ("0 0 open 0 0 0 0", "line 1"),
        ("# nothing", "no line"),
    ],
)
def test_a_script_that_cannot_be_meant_is_refused_with_its_line(tmp_path: Path, text: str, what: str) -> None:
    file = tmp_path / "script.txt"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=what):
        read_script(file)
