"""`pcmrs fsm verify`: what it prints, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main, progress
from pcmrs.cli.fsm.verify import verify
from pcmrs.fsm.finding import Finding
from tests import TESTS
from tests.unit.fsm.ratms_mutants import FILE

UNSOUND = TESTS / "unit" / "fsm" / "unsound"


def run(*arguments: str | Path, given: bytes | None = None) -> Result:
    return CliRunner().invoke(verify, [str(argument) for argument in arguments], input=given)


def test_a_sound_workflow_takes_one_line() -> None:
    result = run(FILE)
    assert result.exit_code == 0
    assert result.stdout == f"{FILE}: sound: 40 joint states, 2147 transitions, 16 properties\n"
    assert result.stderr == ""


def test_a_finding_has_its_place_and_its_commands() -> None:
    file = UNSOUND / "goal_lost.toml"
    result = run(file)
    first, second, last = result.stdout.splitlines()
    assert first.startswith(f"{file}:18:2: goal_lost: From door=bricked ")
    assert second == "    1. door.brick"
    assert last == f"{file}: unsound: 1 finding"
    assert result.exit_code == 1


def test_worst_file_sets_the_exit_code_and_all_are_verified() -> None:
    files = [FILE, UNSOUND / "deadlock.toml", UNSOUND / "not_toml.toml"]
    result = run("--json", *files)
    assert result.exit_code == 5
    found = json.loads(result.stdout)
    assert [(each["file"], each["readable"], each["sound"]) for each in found] == [
        (str(files[0]), True, True),
        (str(files[1]), True, False),
        (str(files[2]), False, False),
    ]
    assert (found[0]["joint_states"], found[0]["transitions"]) == (40, 2147)
    assert [finding["code"] for finding in found[1]["findings"]] == ["deadlock"]
    assert found[1]["findings"][0]["commands"] == ["door.open"]


def test_the_limit_can_be_set_and_standard_input_read() -> None:
    result = run("--limit", "33", "-", given=FILE.read_bytes())
    assert result.exit_code == 1
    assert "<stdin>:12:2: too_many_states: There are more than 33 joint states" in result.stdout


@pytest.mark.parametrize("given", [b"", b"\xff", b"id = 1", b"[" * 10_000])
def test_file_that_is_no_workflow_is_unreadable(given: bytes) -> None:
    result = run("-", given=given)
    assert result.exit_code == 5
    assert "<stdin>: unreadable: 1 finding" in result.stdout


def test_unreadable_file_is_a_finding_and_others_are_verified(tmp_path: Path) -> None:
    missing = tmp_path / "none.toml"
    files: list[str | Path] = [missing, tmp_path, "no_such_workflow", FILE]
    result = run("--json", *files)
    assert result.exit_code == 5
    assert result.stderr == ""
    found = json.loads(result.stdout)
    assert [each["sound"] for each in found] == [False, False, False, True]
    assert [[finding["code"] for finding in each["findings"]] for each in found] == [["cannot_be_read"]] * 3 + [[]]
    assert found[0]["findings"][0]["file"] == str(missing)
    assert "none.toml cannot be read: No such file" in run(*files).stdout


def test_text_in_a_file_forges_no_line_and_no_terminal_code() -> None:
    forged = b'text = "\\nx.toml: sound: 1 joint states\\u001b[31m\\u202e"\n'
    raw = (
        (UNSOUND / "property_violated.toml")
        .read_bytes()
        .replace(b"[[properties]]  # here\n", b"[[properties]]\n" + forged)
    )
    shown = run("-", given=raw).stdout
    assert "\\nx.toml: sound" in shown
    assert all(line.isprintable() for line in shown.split("\n"))
    finding = json.loads(run("--json", "-", given=raw).stdout)[0]["findings"][0]
    assert "\nx.toml: sound: 1 joint states\x1b[31m\u202e" in finding["text"]
    assert "\n" not in str(Finding(**finding))


@pytest.mark.parametrize("arguments", [("verify", str(FILE)), ("design", "examples/ratms_steps.toml")])
@pytest.mark.parametrize(("long", "shown"), [(0, True), (1_000_000, False)])
def test_a_long_search_shows_how_far_it_is(
    arguments: tuple[str, str], long: int, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "LONG", long)
    terminal = {"FORCE_COLOR": "1", "TERM": "xterm", "COLUMNS": "200"}
    result = CliRunner(env=terminal).invoke(main, ["fsm", *arguments])
    assert result.exit_code == 0
    assert ("joint states of" in result.stderr) == shown
