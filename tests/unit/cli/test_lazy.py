"""Every command is found by its name and loaded only when it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest
from click.testing import CliRunner

from pcmrs.cli import COMMANDS
from pcmrs.cli.lazy import LazyGroup
from tests.unit.cli.command_line import run


@pytest.mark.parametrize("words", [["--help"], ["call", "--help"], *([name, "--help"] for name in COMMANDS)])
def test_everything_explains_itself(words: list[str]) -> None:
    ended = run(*words)
    assert ended.exit_code == 0
    assert "Usage" in ended.stdout


def test_an_unknown_command_is_a_usage_error() -> None:
    ended = run("explode")
    assert ended.exit_code == 2
    assert "explode" in ended.stderr


def test_help_needs_neither_kinematics_nor_simulation() -> None:
    code = (
        "import sys, pcmrs.cli.cell, pcmrs.cli.serve, pcmrs.cli.journal;"
        "print([name for name in ('pinocchio', 'mujoco', 'scipy') if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.strip() == "[]"


def test_a_command_of_a_missing_distribution_names_it() -> None:
    group = LazyGroup(name="pcmrs", commands={"demo": "pcmrs-none", "call": "pcmrs.cli.cell:call"}, prefix=None)
    ended = CliRunner().invoke(group, ["demo"])
    assert ended.exit_code == 2
    assert "'pcmrs demo' is a command of pcmrs-none, which is not installed" in ended.stderr
    listed = CliRunner().invoke(group, ["--help"]).stdout
    assert "call" in listed
    assert "demo" not in listed, "what cannot be run is not offered"


WORDS = [["explode\x1b[2J"], ["report", "--\x1b[2J"], ["journal", "export", "-o", "out\x1b[2J"]]


@pytest.mark.parametrize("words", WORDS, ids=["command", "option", "file"])
def test_a_usage_error_controls_no_terminal(words: list[str]) -> None:
    ended = run(*words)
    assert ended.exit_code == 2
    assert "1b[2J" in ended.stderr, "without a terminal, click would drop the sequence"
    assert all(map(str.isprintable, ended.stderr.split("\n")))
