"""`pcmrs backup` and `pcmrs restore`: what a backup has and lacks is printed, and so is what a restored cell needs."""

from __future__ import annotations

import json
from pathlib import Path

from tests.unit.cli.command_line import run
from tests.unit.maintenance.labs import Lab, contents, unpacked


def backup(lab: Lab, target: Path, *words: str) -> tuple[str, ...]:
    settings = ("--config", str(lab.configuration), "--set", f"cell.folder={lab.cell}")
    return ("backup", str(target), *settings, *words)


def test_a_backup_is_reported_with_its_last_row(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    (present.cell / "console.token").write_text("token")
    ended = run(*backup(present, tmp_path / "copy"))
    assert ended.exit_code == 0, ended.stderr
    manifest = json.loads((tmp_path / "copy" / "backup.json").read_text())
    journal = manifest["journals"]["ratms.sqlite"]
    assert f"ratms.sqlite: {journal['rows']} rows, last hash {journal['hash']}" in ended.stdout
    assert "not in the backup: console.token" in ended.stdout
    named = {path.name for path in (tmp_path / "copy" / "configuration").iterdir()}
    assert named == {"cell.toml", "pointer.toml"}


def test_no_recordings_leaves_them_out(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    ended = run(*backup(present, tmp_path / "copy", "--no-recordings", "--json"))
    assert json.loads(ended.stdout)["manifest"]["left_out"] == ["recordings"]
    assert not (tmp_path / "copy" / "recordings").exists()


def test_an_existing_target_is_refused_with_status_4(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    (tmp_path / "copy").mkdir()
    ended = run(*backup(present, tmp_path / "copy"))
    assert ended.exit_code == 4
    assert "exists already" in ended.stderr


def test_a_restored_cell_is_reported_with_what_is_needed(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    assert run(*backup(present, tmp_path / "copy")).exit_code == 0
    ended = run("restore", str(tmp_path / "copy"), str(tmp_path / "restored"))
    assert ended.exit_code == 0, ended.stderr
    assert "starts latched" in ended.stdout
    assert str(tmp_path / "copy" / "configuration") in ended.stdout
    shown = run("journal", "show", str(tmp_path / "restored" / "ratms.sqlite"), "--last", "1")
    assert "restored from a backup" in shown.stdout
    assert run("journal", "verify", str(tmp_path / "restored" / "ratms.sqlite")).exit_code == 0


def test_a_changed_backup_has_status_5(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    assert run(*backup(present, tmp_path / "copy")).exit_code == 0
    (tmp_path / "copy" / "journal.pub").write_text("other")
    before = contents(tmp_path)
    ended = run("restore", str(tmp_path / "copy"), str(tmp_path / "restored"))
    assert ended.exit_code == 5
    assert "was changed after it was made" in ended.stderr
    assert contents(tmp_path) == before
