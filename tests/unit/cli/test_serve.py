"""`pcmrs-serve` and its nodes refuse a wrong configuration with the key that is wrong."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.cli.serve import serve


@pytest.fixture(autouse=True)
def umask_of_others() -> Iterator[None]:
    """The command changes the umask of this process, in which other tests follow."""
    before = os.umask(0o022)
    yield
    os.umask(before)


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


def test_others_may_not_read_what_the_command_writes(tmp_path: Path) -> None:
    CliRunner().invoke(serve, ["--set", "nonsense"])
    file = tmp_path / "written"
    file.touch()
    assert file.stat().st_mode & 0o077 == 0
