"""`pcmrs journal replay`: where there is no journal of a workflow, it says so in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import TESTS
from tests.unit.cli.journals import journal_command

GOLDEN = TESTS / "unit" / "replay" / "golden" / "ratms.jsonl"


def test_the_summary_counts_what_was_repeated() -> None:
    shown = journal_command("replay", GOLDEN)
    assert shown.exit_code == 0, shown.stderr
    report = json.loads(journal_command("replay", GOLDEN, "--json").stdout)
    assert report["differences"] == []
    assert report["rows"] == len(GOLDEN.read_text().splitlines())
    summary = " ".join(shown.stdout.split())
    assert f"{report['rows']} rows of {report['runs']} runs, {report['compared']} repeated, all as recorded" in summary


def test_a_journal_without_the_start_of_a_run_is_not_replayed(journal_path: Path) -> None:
    ended = journal_command("replay", journal_path)
    assert ended.exit_code == 5
    assert ended.stdout == ""
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.parametrize("name", ["none.sqlite", "none.jsonl"])
def test_a_journal_that_is_not_there_is_named(tmp_path: Path, name: str) -> None:
    ended = journal_command("replay", tmp_path / name)
    assert ended.exit_code == 5
    assert name in ended.stderr
