"""`pcmrs backup` and `pcmrs restore`: what a backup has and lacks is printed, and so is what a restored cell needs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from pcmrs.workflows import find_workflow
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


def own_workflow(folder: Path) -> Path:
    """Write a workflow that extends another one, with its code and its approval, and return its file."""
    folder.mkdir()
    shutil.copy(find_workflow("ratms").blueprint, folder / "base.toml")
    text = 'extends = "base.toml"\nid = "own"\nversion = "1"\ntitle = "Own"\ngoal = { procedure = ["finished"] }\n'
    (folder / "own.toml").write_text(text)
    (folder / "own.py").write_text("from pcmrs.workflows.ratms import *\n")
    (folder / "own.approval.json").write_text("{}")
    return folder / "own.toml"


def test_a_backup_has_all_files_of_the_workflow(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    own = own_workflow(tmp_path / "flow")
    ended = run(*backup(present, tmp_path / "copy", "--set", f"workflow={own}"))
    assert ended.exit_code == 0, ended.stderr
    copied = contents(tmp_path / "copy" / "configuration")
    assert copied.keys() == {"cell.toml", "pointer.toml", *contents(own.parent)}
    assert {name: copied[name] for name in contents(own.parent)} == contents(own.parent)


def test_a_backup_has_the_tools_of_the_tracker(tmp_path: Path) -> None:
    present = unpacked("format-2", tmp_path)
    tool = tmp_path / "coil.rom"
    tool.write_bytes(b"NDI")
    changed = ("cell.rate=1", "tracker.driver=ndi", f"ndi.tools.coil={tool}", f"ndi.tools.witness={tool}")
    ended = run(*backup(present, tmp_path / "copy", *(word for each in changed for word in ("--set", each))))
    assert ended.exit_code == 0, ended.stderr
    assert (tmp_path / "copy" / "configuration" / "coil.rom").read_bytes() == b"NDI"


@pytest.mark.parametrize(("name", "other"), [("base.toml", "pointer.toml"), ("own.toml", "cell.toml")])
def test_two_named_files_with_one_name_give_no_backup(tmp_path: Path, name: str, other: str) -> None:
    present = unpacked("format-2", tmp_path)
    own = own_workflow(tmp_path / "flow")
    own.write_text(own.read_text().replace(name, other))
    (own.parent / name).rename(own.parent / other)
    workflow = own if own.exists() else own.parent / other
    ended = run(*backup(present, tmp_path / "copy", "--set", f"workflow={workflow}"))
    assert ended.exit_code == 4
    assert f"would both be {other} in the backup" in " ".join(ended.stderr.split())
    assert not (tmp_path / "copy").exists()


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
