"""Bars on standard error: only where there is something to wait for; lines where there is no terminal."""

from __future__ import annotations

import pytest

from pcmrs.cli.progress import progress_bar


def test_a_bar_says_what_is_done_and_how_much(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar() as show:
        show("seed 1 [bold]", 2, 3)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "seed 1 [bold]" in shown.err
    assert "2/3" in shown.err


@pytest.mark.parametrize("beyond", [0, 3])
def test_nothing_shows_before_there_is_more_to_do(beyond: int, capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(beyond=beyond) as show:
        if beyond:
            show("short", 1, beyond)
    assert capsys.readouterr().err == ""


def test_a_bar_that_is_wiped_off_leaves_nothing_in_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(transient=True) as show:
        show("search", 1, 3)
    assert capsys.readouterr().err == ""


def test_log_file_gets_the_first_and_the_last_of_quick_steps(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar() as show:
        for done in range(1, 6):
            show(f"row {done}", done, 5)
    assert capsys.readouterr().err.splitlines() == ["1/5 row 1", "5/5 row 5"]
