"""Commands on a running cell: without a daemon they say so, and what cannot be sent is refused before."""

from __future__ import annotations

import pytest

from pcmrs.testing.daemon import free_port
from tests.unit.cli.command_line import run


@pytest.fixture
def nobody() -> str:
    """An endpoint at which nobody listens."""
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.mark.parametrize(
    "words", [["call", "robot.connect"], ["state"], ["state", "--json"], ["keys"], ["watch"], ["stop"]]
)
def test_without_a_daemon_the_status_is_3_with_one_error_line(words: list[str], nobody: str) -> None:
    ended = run(*words, "--endpoint", nobody)
    assert ended.exit_code == 3
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert nobody in line
    assert "pcmrs-serve" in line


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["robot.connect", "{index: 0}"], "not JSON"),
        (["robot.connect", "[1, 2]"], "JSON object"),
        (["robot.connect", "5"], "JSON object"),
        (["robot.connect", '{"a": ' + "[" * 20000 + "]" * 20000 + "}"], "not JSON"),
        (["robot.connect", '{"a": ' + "1" * 5000 + "}"], "not JSON"),
    ],
)
def test_arguments_that_are_no_json_object_are_refused_unsent(words: list[str], text: str) -> None:
    ended = run("call", *words)
    assert ended.exit_code == 2
    (line,) = ended.stderr.splitlines()
    assert text in line
