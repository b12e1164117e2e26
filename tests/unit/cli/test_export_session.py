"""`pcmrs export-session`: one folder, or one line that says why there is none."""

from __future__ import annotations

import json
from pathlib import Path

from tests.unit.cli.command_line import run
from tests.unit.cli.journals import cut


def words(folder: Path, *more: str) -> tuple[str, ...]:
    return ("export-session", "--set", f"cell.folder={folder}", "-o", str(folder / "out"), *more)


def test_the_last_session_is_exported_and_counted(tmp_path: Path, journal_path: Path) -> None:
    ended = run(*words(tmp_path, "--json"))
    assert ended.exit_code == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert (found["session"], found["rows"], found["problems"]) == ("s", 12, [])
    assert any("recordings" in line for line in found["missing"])
    assert (tmp_path / "out" / "README.txt").is_file()
    assert journal_path.is_file(), "the cell keeps its own"


def test_damage_is_exported_as_it_is_with_status_1(tmp_path: Path, journal_path: Path) -> None:
    cut(journal_path, 7)
    ended = run(*words(tmp_path))
    assert ended.exit_code == 1
    assert "the journal is not sound: " in ended.stdout
    assert (tmp_path / "out" / "README.txt").is_file()


def test_no_journal_or_no_such_session_exports_nothing(tmp_path: Path, journal_path: Path) -> None:
    for folder, more in ((tmp_path, ("--session", "x")), (tmp_path / "empty", ())):
        ended = run(*words(folder, *more))
        assert ended.exit_code == 5
        assert len(ended.stderr.splitlines()) == 1
        assert not (folder / "out").exists()


def test_a_folder_that_is_in_use_stays_as_it_is(tmp_path: Path, journal_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    ended = run(*words(tmp_path))
    assert ended.exit_code == 4
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["mine.txt"]


def rename(journal: Path, name: str) -> None:
    """Rename a journal with its head and key."""
    for file in journal.parent.glob(f"{journal.name}*"):
        file.rename(file.with_name(file.name.replace(journal.name, name)))


def test_the_only_journal_needs_no_name_of_its_workflow(tmp_path: Path, journal_path: Path) -> None:
    rename(journal_path, "biopsy.sqlite")
    ended = run(*words(tmp_path, "--json"))
    assert ended.exit_code == 0, ended.stderr
    assert json.loads(ended.stdout)["rows"] == 12


def test_of_several_other_journals_one_has_to_be_named(tmp_path: Path, journal_path: Path) -> None:
    (tmp_path / "grid.sqlite").write_bytes(journal_path.read_bytes())
    rename(journal_path, "biopsy.sqlite")
    ended = run(*words(tmp_path))
    assert ended.exit_code == 4
    assert "biopsy, grid" in ended.stderr
    assert "--set workflow=NAME" in ended.stderr
    assert not (tmp_path / "out").exists()
