"""Poses come from a file or from the cell, and options of the other way are refused."""

from __future__ import annotations

import pytest

from tests.unit.cli.calibrate.calibrations import run


@pytest.mark.parametrize("words", [[], ["poses.csv", "--live"]])
def test_either_a_file_or_live(words: list[str]) -> None:
    ended = run("pivot", *words)
    assert ended.exit_code == 2
    assert "either a FILE" in ended.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("pivot", "poses.csv", "--keep", "kept.csv"), "--keep is for --live only"),
        (("hand-eye", "poses.csv", "--robot", "panda"), "--robot is for --live only"),
        (("pivot", "poses.csv", "--limit-mm", "nan"), "nan is not finite"),
        (("hand-eye", "poses.csv", "--limit-deg", "-1"), "not in the range"),
        (("pivot", "poses.csv", "-o", "no_such_folder/tip.toml"), "no folder no_such_folder"),
    ],
)
def test_option_that_would_be_ignored_or_is_senseless_is_refused(words: tuple[str, ...], said: str) -> None:
    """It is a usage error."""
    ended = run(*words)
    assert ended.exit_code == 2
    assert said in ended.stderr
