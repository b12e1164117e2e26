"""The command line without a daemon: what it says, and with which status it ends."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import COMMANDS, main
from pcmrs.cli.running import readable_errors
from pcmrs.cli.serve import serve
from pcmrs.clock import SystemClock
from pcmrs.errors import PcmrsError
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Command, Reason, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.daemon import free_port


@pytest.fixture
def nobody() -> str:
    """An endpoint at which nobody listens."""
    return f"tcp/127.0.0.1:{free_port()}"


def _run(*words: str) -> Result:
    return CliRunner().invoke(main, words)


@pytest.mark.parametrize(
    "words", [["call", "robot.connect"], ["state"], ["state", "--json"], ["keys"], ["watch"], ["stop"]]
)
def test_without_a_daemon_the_status_is_3_with_one_error_line(words: list[str], nobody: str) -> None:
    ended = _run(*words, "--endpoint", nobody)
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
    ended = _run("call", *words)
    assert ended.exit_code == 2
    (line,) = ended.stderr.splitlines()
    assert text in line


@pytest.mark.parametrize("words", [["--help"], ["call", "--help"], *([name, "--help"] for name in COMMANDS)])
def test_everything_explains_itself(words: list[str]) -> None:
    ended = _run(*words)
    assert ended.exit_code == 0
    assert "Usage" in ended.stdout


def test_an_unknown_command_is_a_usage_error() -> None:
    ended = _run("explode")
    assert ended.exit_code == 2
    assert "explode" in ended.stderr


def test_help_needs_neither_kinematics_nor_simulation() -> None:
    code = (
        "import sys, pcmrs.cli.cell, pcmrs.cli.serve, pcmrs.cli.journal;"
        "print([name for name in ('pinocchio', 'mujoco', 'scipy') if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("override", "word"),
    [
        ("cell.nam=x", "nam"),
        ("procedure.max_pose_age=soon", "max_pose_age"),
        ("workflow=osteotomy", "osteotomy"),
        ("robot.model=iiwa9", "iiwa9"),
        ("nonsense", "key=value"),
    ],
)
def test_a_bad_configuration_ends_with_4_and_names_the_key(override: str, word: str, tmp_path: Path) -> None:
    ended = CliRunner().invoke(serve, ["--set", f"cell.folder={tmp_path}", "--set", override])
    assert ended.exit_code == 4
    (line,) = ended.stderr.splitlines()
    assert word in line


def test_a_configuration_file_that_is_missing_is_named(tmp_path: Path) -> None:
    ended = CliRunner().invoke(serve, ["--config", str(tmp_path / "nowhere.toml")])
    assert ended.exit_code == 4
    assert "nowhere.toml" in ended.stderr


def test_a_node_wants_a_configuration() -> None:
    ended = CliRunner().invoke(main, ["node", "sim", "robot"], input="nonsense\n")
    assert ended.exit_code == 4
    assert "configuration" in ended.stderr


def _write_journal(folder: Path) -> Path:
    async def write() -> None:
        journal = Journal.open(folder / "ratms.sqlite", durable=False)
        recorder = JournalRecorder(journal, SystemClock(), "session", BlueprintTag(id="ratms", version="1", hash="0"))
        for number in range(3):
            command = Command(id=f"c{number}", branch="robot", operation="connect", source="bus:local")
            refused = Reason(code="silent", text="The robot is silent.")
            verdict = Verdict(
                id=command.id,
                branch="robot",
                operation="connect",
                decision="failed",
                state="0",
                sequence=1,
                reason=refused,
            )
            await recorder.decision(command, verdict, {"robot": "0"}, {}, with_intent=True)
        await journal.close()

    asyncio.run(write())
    return folder / "ratms.sqlite"


def test_journal_is_shown_oldest_first_and_only_its_last_rows(tmp_path: Path) -> None:
    path = _write_journal(tmp_path)
    shown = _run("journal", "show", str(path))
    assert shown.exit_code == 0
    lines = shown.stdout.splitlines()
    assert len(lines) == 6
    assert "robot.connect" in lines[0]
    assert "failed: The robot is silent." in lines[1]
    last = _run("journal", "show", str(path), "--last", "2", "--json")
    rows = [json.loads(line) for line in last.stdout.splitlines()]
    assert [row["row"]["command_id"] for row in rows] == ["c2", "c2"]


def test_a_journal_that_is_not_there_is_named(tmp_path: Path) -> None:
    ended = _run("journal", "show", str(tmp_path / "none.sqlite"))
    assert ended.exit_code == 2
    (line,) = ended.stderr.splitlines()
    assert "none.sqlite" in line


def test_options_for_a_cell_are_refused_where_no_cell_is_tested() -> None:
    for option in (["--connect"], ["--rate", "5"], ["--arguments", "mine.toml"], ["--set", "sim.seed=2"]):
        ended = _run("fsm", "test", "ratms", *option)
        assert ended.exit_code == 2
        assert f"{option[0]} is for --live only" in ended.stderr


def test_name_means_the_installed_workflow_not_a_local_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is verified is what a daemon would run."""
    (tmp_path / "ratms").write_text("not a blueprint")
    monkeypatch.chdir(tmp_path)
    assert _run("fsm", "verify", "ratms").exit_code == 0
    assert _run("fsm", "verify", "./ratms").exit_code == 2


def test_lines_of_an_error_cannot_pass_for_a_message() -> None:
    """A table in an error can be copied; a line break in a value from outside begins no line of PCMRS."""

    @click.command()
    @readable_errors
    def failing() -> None:
        raise PcmrsError("Add this:\n\n[[migrations]]\nhash = '1'\npcmrs: all is well\x1b[2J")

    ended = CliRunner().invoke(failing)
    assert ended.stderr.splitlines() == [
        "failing: Add this:",
        "",
        "  [[migrations]]",
        "  hash = '1'",
        "  pcmrs: all is well\\u001b[2J",
    ]
