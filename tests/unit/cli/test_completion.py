"""Completion in shells: what the pages tell a user to evaluate completes commands and options."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

BIN = Path(sys.executable).parent


def completed(shell: str, words: str, position: int) -> list[str]:
    """Ask the command line itself, as the script of the shell does."""
    asked = {"COMP_WORDS": words, "COMP_CWORD": str(position), "_PCMRS_COMPLETE": f"{shell}_complete"}
    if shell == "fish":
        asked["COMP_CWORD"] = words.split()[position]
    ended = subprocess.run(
        [BIN / "pcmrs"], env=os.environ | asked, capture_output=True, text=True, timeout=60, check=True
    )
    return ended.stdout.split()


@pytest.mark.parametrize(
    ("shell", "expected"),
    [("bash", "plain,state"), ("zsh", "state"), ("fish", "plain,state")],
    ids=["bash", "zsh", "fish"],
)
def test_a_command_is_completed(shell: str, expected: str) -> None:
    found = completed(shell, "pcmrs sta", 1)
    assert any(word.startswith(expected) for word in found)


def test_an_option_of_a_command_is_completed() -> None:
    assert "plain,--json" in completed("bash", "pcmrs state --js", 2)


def test_bash_completes_after_evaluating_the_line_of_the_page() -> None:
    page = (Path(__file__).parents[3] / "docs" / "cli.md").read_text()
    line = next(line for line in page.splitlines() if "bash_source" in line)
    script = f"{line}\nCOMP_WORDS=(pcmrs journ); COMP_CWORD=1; _pcmrs_completion pcmrs; echo ${{COMPREPLY[@]}}"
    path = {"PATH": f"{BIN}:{os.environ['PATH']}"}
    ended = subprocess.run(["bash", "-c", script], env=os.environ | path, capture_output=True, text=True, timeout=60)
    assert ended.stdout.split() == ["journal"], ended.stderr
