"""Every command is found by its name and loaded only when it is used."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner

from pcmrs.cli import COMMANDS, SECTIONS, main
from pcmrs.cli.lazy import LazyCommand, LazyGroup
from tests.unit.cli.command_line import run


@pytest.mark.parametrize("words", [["--help"], ["call", "--help"], *([name, "--help"] for name in COMMANDS)])
def test_everything_explains_itself(words: list[str]) -> None:
    ended = run(*words)
    assert ended.exit_code == 0
    assert "Usage" in ended.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["explode"], "No such command 'explode'."),
        (["stat"], "Did you mean 'state'?"),
        (["calibrate", "pivto"], "Did you mean 'pivot'?"),
        (["state", "--jsn"], "Did you mean '--json'?"),
    ],
)
def test_an_unknown_word_is_a_usage_error_with_what_was_meant(words: list[str], says: str) -> None:
    ended = run(*words)
    assert ended.exit_code == 2
    assert says in ended.stderr


def test_help_has_every_command_once_below_a_heading() -> None:
    assert sorted(name for names in SECTIONS.values() for name in names) == sorted(COMMANDS.keys() - {"node"})
    lines = run("--help").stdout.splitlines()
    for name in COMMANDS.keys() - {"node"}:
        assert sum(line.split()[:1] == [name] for line in lines) == 1, name
    assert not any(line.endswith("...") for line in lines[1:])


def lazy_groups(group: LazyGroup) -> Iterator[LazyGroup]:
    """A group and all groups in it."""
    yield group
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, LazyGroup):
            yield from lazy_groups(command)


@pytest.mark.parametrize("room", [20, 45, 60, 1000])
def test_help_of_a_group_says_what_its_commands_say(room: int) -> None:
    assert isinstance(main, LazyGroup)
    for group in lazy_groups(main):
        context = click.Context(group)
        for name in group.list_commands(context):
            described, command = group._described(context, name), group.get_command(context, name)
            assert described is not None
            assert command is not None
            assert described.hidden == command.hidden, name
            if not command.hidden:
                assert described.get_short_help_str(room) == command.get_short_help_str(room)


@pytest.mark.parametrize("words", [[], ["fsm"], ["faults"], ["calibrate"], ["archive"]])
def test_help_of_a_group_loads_no_command(words: list[str]) -> None:
    code = (
        "import sys, pcmrs.cli;"
        f"pcmrs.cli.main({[*words, '--help']}, standalone_mode=False);"
        "heavy = 'zenoh', 'rich', 'structlog', 'cryptography', 'asyncio', 'sqlite3';"
        "print([name for name in heavy if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.splitlines()[-1] == "[]"


def test_help_needs_neither_kinematics_nor_simulation() -> None:
    code = (
        "import sys, pcmrs.cli.cell, pcmrs.cli.serve, pcmrs.cli.journal;"
        "print([name for name in ('pinocchio', 'mujoco', 'scipy') if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.strip() == "[]"


def test_a_command_of_a_missing_distribution_names_it() -> None:
    commands = {"demo": LazyCommand("pcmrs-none"), "call": LazyCommand("pcmrs.cli.cell:call")}
    group = LazyGroup(name="pcmrs", commands=commands, prefix=None)
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
