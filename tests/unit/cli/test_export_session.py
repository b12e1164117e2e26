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
        assert ended.exit_code == 2
        assert len(ended.stderr.splitlines()) == 1
        assert not (folder / "out").exists()


def test_a_folder_that_is_in_use_stays_as_it_is(tmp_path: Path, journal_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    ended = run(*words(tmp_path))
    assert ended.exit_code == 4
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["mine.txt"]
