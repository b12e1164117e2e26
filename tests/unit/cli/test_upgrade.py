"""`pcmrs upgrade`: what will happen is said beforehand, and what has happened afterwards."""

from __future__ import annotations

import json
from pathlib import Path

from tests.unit.cli.command_line import run
from tests.unit.maintenance.labs import contents, unpacked


def test_check_says_what_will_happen_and_changes_nothing(tmp_path: Path) -> None:
    first = unpacked("first", tmp_path)
    before = contents(first.folder)
    ended = run("upgrade", "--check", str(first.cell), "--config", str(first.configuration))
    assert ended.exit_code == 0, ended.stderr
    lines = ended.stdout.splitlines()
    (journal,) = [line for line in lines if line.lstrip().startswith("journal")]
    assert journal.split()[:4] == ["journal", "2", "3", "upgrade"]
    assert any(line.lstrip().startswith("calibration") for line in lines)
    assert "the old one is kept" in ended.stdout
    assert contents(first.folder) == before


def test_an_upgrade_names_the_kept_folder(tmp_path: Path) -> None:
    first = unpacked("first", tmp_path)
    ended = run("upgrade", str(first.cell), "--config", str(first.configuration))
    assert ended.exit_code == 0, ended.stderr
    (kept,) = first.folder.glob("cell.before-*")
    assert "journal: format 2 to 3" in ended.stdout
    assert str(kept) in ended.stdout
    again = run("upgrade", str(first.cell), "--json")
    assert json.loads(again.stdout) == {"folder": str(first.cell), "upgraded": [], "kept": None}


def test_a_refused_folder_has_status_1_or_4(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    present.edit("cell/cell.json", lambda _: b'{"format": 3, "program": "9.1"}')
    checked = run("upgrade", "--check", str(present.cell))
    assert checked.exit_code == 1
    assert "PCMRS 9.1 wrote it" in checked.stdout
    upgraded = run("upgrade", str(present.cell))
    assert upgraded.exit_code == 4
    assert "PCMRS 9.1 wrote it" in upgraded.stderr


def test_a_configuration_that_cannot_be_read_is_in_the_check(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    present.edit("cell.toml", lambda text: b"schema = 2\n" + text)
    checked = run("upgrade", "--check", str(present.cell), "--config", str(present.configuration), "--json")
    assert checked.exit_code == 1
    (refused,) = [file for file in json.loads(checked.stdout)["files"] if file["action"] == "refuse"]
    assert refused["kind"] == "configuration"
    assert Path(refused["file"]) == present.configuration
