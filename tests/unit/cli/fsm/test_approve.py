"""`pcmrs fsm approve`: what it signs, and what it refuses."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from pcmrs.authoring.design import design
from pcmrs.cli import main
from pcmrs.clock import SystemClock
from pcmrs.fsm import load_blueprint
from pcmrs.pki import Authority, read_approval, read_credentials
from tests.unit.authoring.design.step_tables import step, table

ORIGIN = {"model": "made", "prompt": "ab", "protocol": "cd", "date": "2026-11-27"}


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder with an authority, the identities of a person and a cell, and a drafted workflow."""
    now = SystemClock().wall()
    authority = Authority.init(tmp_path / "pki", "lab", now)
    authority.issue("operator", "anna", now, cells=["lab/c1"], into=tmp_path)
    authority.issue("daemon", "cell", now, cells=["lab/c1"], into=tmp_path)
    (tmp_path / "drafted.toml").write_text(design(table(step("a"), provenance=ORIGIN)).text)
    return tmp_path


def approved(lab: Path, *words: str, file: str = "drafted.toml") -> Result:
    return CliRunner().invoke(main, ["fsm", "approve", str(lab / file), "--identity", str(lab / "anna"), *words])


def test_the_daemon_accepts_what_the_command_has_signed(lab: Path) -> None:
    result = approved(lab, "--yes")
    assert result.exit_code == 0, result.output
    blueprint = load_blueprint(lab / "drafted.toml")
    assert f"anna has approved demo 1, hash {blueprint.hash}" in result.stdout
    own = read_credentials(lab / "cell", SystemClock().wall())
    members = Authority(lab / "pki").identities()
    approval = read_approval(blueprint, lab / "drafted.toml", own, members, "lab/c1", time.time())
    assert approval is not None
    assert approval.by == "anna"


def test_the_approval_is_printed_as_json(lab: Path) -> None:
    said = json.loads(approved(lab, "--yes", "--json").stdout)
    assert said["file"] == str(lab / "drafted.approval.json")
    assert (said["approval"]["id"], said["approval"]["by"]) == ("demo", "anna")


def test_nothing_is_signed_without_a_persons_answer(lab: Path) -> None:
    result = approved(lab)
    assert result.exit_code == 5
    assert "--yes" in result.stderr
    assert not (lab / "drafted.approval.json").exists()


@pytest.mark.parametrize(
    ("text", "status", "word"),
    [
        (design(table(step("a"))).text, 5, "needs no approval"),
        (table(step("a"), provenance=ORIGIN).decode(), 5, "bad_value"),
        ('id = "x"\nversion = "1"\nbranches = {}\n', 1, "no_branches"),
    ],
)
def test_only_a_sound_drafted_workflow_is_signed(text: str, status: int, word: str, lab: Path) -> None:
    (lab / "other.toml").write_text(text)
    result = approved(lab, "--yes", file="other.toml")
    assert (result.exit_code, word in result.stderr) == (status, True), result.output
    assert not (lab / "other.approval.json").exists()


@pytest.mark.parametrize("file", ["-", "ratms"])
def test_an_approval_needs_a_file_to_stand_beside(file: str, lab: Path) -> None:
    words = ["fsm", "approve", file, "--identity", str(lab / "anna"), "--yes"]
    assert CliRunner().invoke(main, words).exit_code == 5


@pytest.mark.parametrize(("answer", "status"), [(b"n\n", 5), (b"y\n", 0)])
def test_at_a_terminal_it_shows_what_is_signed_and_asks(answer: bytes, status: int, lab: Path) -> None:
    command = [sys.executable, "-m", "pcmrs.cli", "fsm", "approve", str(lab / "drafted.toml")]
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [*command, "--identity", str(lab / "anna")], stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        os.close(theirs)
        os.write(ours, answer)
        _, said = process.communicate(timeout=100)
        os.close(ours)
    assert process.returncode == status, said
    assert b"drafted by made on 2026-11-27" in said
    assert (lab / "drafted.approval.json").exists() == (status == 0)
