"""`pcmrs fsm diff`: what it prints, and how it ends."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from pcmrs.authoring.difference import BlueprintDifference
from pcmrs.cli import main
from tests.support.ratms_oracle import BLUEPRINT


@pytest.mark.nightly
def test_the_command_says_what_differs_and_how_it_ends(tmp_path: Any) -> None:
    text = BLUEPRINT.read_text()
    same, other, broken = (tmp_path / f"{name}.toml" for name in ("same", "other", "broken"))
    same.write_text(f"# a comment\n{text}")
    other.write_text(text.replace("timeout_s = 300", "timeout_s = 301"))
    broken.write_text("[")
    runs = [CliRunner().invoke(main, ["fsm", "diff", str(BLUEPRINT), str(new)]) for new in (same, other, broken)]
    assert [run.exit_code for run in runs] == [0, 1, 2]
    assert runs[0].output == "The same behaviour.\n"
    assert "digitization.digitize_all: timeout_s changed from 300.0 to 301.0" in runs[1].output
    as_json = CliRunner().invoke(main, ["fsm", "diff", str(BLUEPRINT), str(other), "--json"])
    (difference,) = msgspec.json.decode(as_json.output, type=list[BlueprintDifference])
    assert (difference.kind, difference.old, difference.new) == ("changed", "300.0", "301.0")
