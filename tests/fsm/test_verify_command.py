"""`pcmrs fsm verify`: what it prints, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from ratms_mutants import FILE

from pcmrs.cli.fsm.verify import verify

UNSOUND = Path(__file__).parent / "unsound"


def run(*arguments: str | Path, given: bytes | None = None) -> Result:
    return CliRunner().invoke(verify, [str(argument) for argument in arguments], input=given)


def test_a_sound_workflow_takes_one_line() -> None:
    result = run(FILE)
    assert result.exit_code == 0
    assert result.stdout == f"{FILE}: sound: 34 joint states, 1153 transitions, 7 properties\n"
    assert result.stderr == ""


def test_a_finding_has_its_place_and_its_commands() -> None:
    file = UNSOUND / "goal_lost.toml"
    result = run(file)
    first, second, last = result.stdout.splitlines()
    assert first.startswith(f"{file}:18:2: goal_lost: From door=bricked ")
    assert second == "    1. door.brick"
    assert last == f"{file}: unsound: 1 finding"
    assert result.exit_code == 1


def test_the_worst_file_decides_how_it_ends_and_all_are_looked_at() -> None:
    files = [FILE, UNSOUND / "deadlock.toml", UNSOUND / "not_toml.toml"]
    result = run("--json", *files)
    assert result.exit_code == 2
    found = json.loads(result.stdout)
    assert [(each["file"], each["readable"], each["sound"]) for each in found] == [
        (str(files[0]), True, True),
        (str(files[1]), True, False),
        (str(files[2]), False, False),
    ]
    assert (found[0]["joint_states"], found[0]["transitions"]) == (34, 1153)
    assert [finding["code"] for finding in found[1]["findings"]] == ["deadlock"]
    assert found[1]["findings"][0]["commands"] == ["door.open"]


def test_the_limit_can_be_set_and_standard_input_read() -> None:
    result = run("--limit", "33", "-", given=FILE.read_bytes())
    assert result.exit_code == 1
    assert "<stdin>:9:2: too_many_states: There are more than 33 joint states" in result.stdout


@pytest.mark.parametrize("given", [b"", b"\xff", b"id = 1", b"[" * 10_000])
def test_what_is_no_workflow_is_unreadable(given: bytes) -> None:
    result = run("-", given=given)
    assert result.exit_code == 2
    assert "<stdin>: unreadable: 1 finding" in result.stdout


def test_a_file_that_is_not_there_is_unreadable(tmp_path: Path) -> None:
    result = run(tmp_path / "none.toml")
    assert result.exit_code == 2
    assert "none.toml" in result.stderr
