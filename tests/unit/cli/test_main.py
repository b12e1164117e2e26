"""Files that a command writes about a session are its owner's alone; others are as the shell says."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.unit.cli.command_line import run


@pytest.fixture(autouse=True)
def umask_of_a_shell() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


def modes(path: Path) -> set[str]:
    """Rights of others on a file, or on a folder and all that is in it."""
    return {oct(each.stat().st_mode & 0o077) for each in (path, *path.rglob("*"))}


@pytest.mark.parametrize(
    "words",
    [
        ("journal", "export", "{journal}", "-o", "{output}.csv"),
        ("export-session", "--set", "cell.folder={folder}", "-o", "{output}"),
        ("report", "{journal}", "-o", "{output}.html"),
    ],
    ids=["journal export", "export-session", "report"],
)
def test_files_of_a_session_are_private(words: tuple[str, ...], tmp_path: Path, journal_path: Path) -> None:
    places = {"journal": journal_path, "folder": tmp_path, "output": tmp_path / "out"}
    ended = run(*(word.format(**places) for word in words))
    assert ended.exit_code == 0, ended.stderr
    (written,) = tmp_path.glob("out*")
    assert modes(written) == {"0o0"}
    assert os.umask(0o022) == 0o022, "other files of the process are as before"


def test_a_workflow_is_for_all_who_may_read_the_folder(tmp_path: Path) -> None:
    assert run("fsm", "generate", "ratms", "-o", str(tmp_path / "ratms.py")).exit_code == 0
    assert modes(tmp_path / "ratms.py") == {"0o44"}
