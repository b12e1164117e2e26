"""`pcmrs fsm render`: a chart on standard output or in a file, and why none is drawn."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli.fsm.render import render
from tests.support.ratms_oracle import BLUEPRINT
from tests.unit.authoring.chart.fonts import skip_without_font

RATMS = str(BLUEPRINT)

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def _font() -> None:
    skip_without_font()


@pytest.mark.parametrize(("form", "begins"), [("svg", "<svg"), ("mermaid", "stateDiagram-v2"), ("dot", "digraph")])
def test_the_command_writes_each_text_to_standard_output(form: str, begins: str) -> None:
    done = CliRunner().invoke(render, [RATMS, "--format", form, "--state", "robot=1"])
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.startswith(begins)


@pytest.mark.usefixtures("_font")
def test_the_command_writes_a_picture_to_a_file(tmp_path: Path) -> None:
    written = tmp_path / "chart.png"
    assert CliRunner().invoke(render, [RATMS, "--format", "png", "-o", str(written)]).exit_code == 0
    assert written.read_bytes().startswith(PNG_SIGNATURE)


@pytest.mark.parametrize(("given_state", "status"), [("robot=7", 5), ("arm=1", 5), ("robot", 2)])
def test_the_command_refuses_a_state_that_is_not_there(given_state: str, status: int) -> None:
    done = CliRunner().invoke(render, [RATMS, "--state", given_state])
    assert (done.exit_code, done.stdout) == (status, "")
    assert given_state.split("=")[0] in done.stderr


@pytest.mark.parametrize(
    ("raw", "status"),
    [(b"\xff", 5), (b"id = 1", 5), (b'id = "x"\nversion = "1"\nbranches.b.states = {}\n', 1)],
)
def test_the_command_says_why_it_cannot_draw(raw: bytes, status: int) -> None:
    done = CliRunner().invoke(render, ["-"], input=raw)
    assert (done.exit_code, done.stdout) == (status, "")
    assert "<stdin>:1" in done.stderr or "<stdin>:3" in done.stderr
