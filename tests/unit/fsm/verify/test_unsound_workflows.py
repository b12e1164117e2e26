"""For every kind of finding there is a workflow that has exactly that one, and it points to the right line."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.fsm._codes import READING, RULES, VERIFICATION
from pcmrs.fsm.files.load import examine

FOLDER = Path(__file__).parents[1] / "unsound"
FILES = sorted(FOLDER.glob("*.toml"), key=lambda file: file.name)


def test_there_is_a_file_for_every_kind_of_finding() -> None:
    """But for one too large to be kept here, one that is not there, and what depends on the steps that are known."""
    elsewhere = {"too_large", "cannot_be_read", "undeclared"}
    assert {file.stem for file in FILES} == {*READING, *RULES, *VERIFICATION} - elsewhere


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_exactly_this_is_found_at_the_lines_marked(file: Path) -> None:
    raw = file.read_bytes()
    marked = {number for number, line in enumerate(raw.split(b"\n"), 1) if line.endswith(b"# here")}
    examination = examine(raw, origin=file.name)
    assert {finding.code for finding in examination.findings} == {file.stem}
    assert {finding.line for finding in examination.findings} == marked
    assert all(finding.file == file.name and finding.column >= 1 for finding in examination.findings)
    assert not examination.sound


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_cut_off_anywhere_it_ends_in_findings_or_success(file: Path) -> None:
    raw = file.read_bytes()
    for length in range(0, len(raw), 37):
        examination = examine(raw[:length], origin=file.name, limit=100)
        assert examination.sound or examination.findings
