"""Runs of the daemon in a journal, and what each passes on to the next."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Workflow
from pcmrs.errors import ReplayError
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.replay._history import CarryOver, DaemonRun, closes_earlier_run, read_runs
from tests.support.shipped import shipped_workflow
from tests.unit.replay.golden import GOLDEN, WORKFLOWS
from tests.unit.report.report_journals import golden_rows, write_journal

RATMS = GOLDEN / "ratms.jsonl"


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_every_row_belongs_to_one_run(workflow: str) -> None:
    runs = read_runs(GOLDEN / f"{workflow}.jsonl")
    assert [stored.sequence for run in runs for stored in run.rows] == list(range(1, len(golden_rows(workflow)) + 1))
    for run in runs:
        assert len({stored.row.session_id for stored in run.rows}) == 1
        assert {stored.row.kind for stored in run.decided()} <= {"intent", "outcome", "device"}
        assert run.settings is not None
        assert run.settings["workflow"] == workflow


def test_a_journal_and_its_export_hold_the_same_runs(tmp_path: Path) -> None:
    exported = read_runs(RATMS)
    journal = read_runs(write_journal(golden_rows("ratms"), tmp_path / "j.sqlite"))
    assert [[each.row for each in run.rows] for run in journal] == [[each.row for each in run.rows] for run in exported]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda lines: [], "has no rows"),
        (lambda lines: lines[:3] + lines[4:], "row 4 is missing"),
        (lambda lines: lines[1:], "row 1 is missing"),
        (lambda lines: [*lines[:2], "{"], "line 3"),
    ],
)
def test_an_incomplete_journal_is_refused(
    tmp_path: Path, content: Callable[[list[str]], list[str]], words: str
) -> None:
    file = tmp_path / "j.jsonl"
    file.write_text("".join(f"{line}\n" for line in content(RATMS.read_text().splitlines())))
    with pytest.raises(ReplayError, match=words):
        read_runs(file)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReplayError, match="cannot be read"):
        read_runs(tmp_path / "none.jsonl")


KILLED = "grid_mapping"
"""The golden daemon of this workflow was killed in a motion."""


def carried(workflow: Workflow[Any, Any], runs: list[DaemonRun]) -> list[tuple[str, Any, Any]]:
    """What the second run closed otherwise than the first one left it."""
    carry_over = CarryOver()
    assert list(carry_over.begin(runs[0], workflow)) == []
    carry_over.end(runs[0], workflow)
    return [(each.row, each.recorded, each.decided) for each in carry_over.begin(runs[1], workflow)]


def test_operations_of_a_killed_run_must_be_closed_by_the_next() -> None:
    workflow, (first, second) = shipped_workflow(KILLED), read_runs(GOLDEN / f"{KILLED}.jsonl")
    assert carried(workflow, [first, second]) == []
    closing = [stored for stored in second.rows if closes_earlier_run(stored)]
    assert closing
    name = f"outcome {closing[0].row.branch}.{closing[0].row.operation}"
    without = replace(second, rows=[stored for stored in second.rows if stored not in closing])
    assert carried(workflow, [first, without]) == [(name, None, "unknown")]
    other = msgspec.structs.replace(closing[0].row, command_id="another")
    added = replace(second, rows=[*second.rows, _with_row(closing[0], other)])
    assert carried(workflow, [first, added]) == [(name, "unknown", None)]


def _with_row(stored: StoredRow, row: JournalRow) -> StoredRow:
    return msgspec.structs.replace(stored, row=row)


def test_a_run_starts_with_the_registration_of_the_one_before() -> None:
    workflow, carry_over = shipped_workflow("ratms"), CarryOver()
    assert carry_over.with_state(workflow).initial.previous is None
    first = read_runs(RATMS)[0]
    carry_over.end(first, workflow)
    stored = [(each.row.result or {}).get("registered") for each in first.rows if each.row.kind == "outcome"]
    accepted = [registered for registered in stored if registered]
    previous = carry_over.with_state(workflow).initial.previous
    assert previous is not None
    assert json.loads(msgspec.json.encode(previous))["id"] == accepted[-1]["id"]


def test_data_of_another_program_are_refused() -> None:
    workflow, carry_over = shipped_workflow("ratms"), CarryOver()
    carry_over.state = msgspec.structs.replace(carry_over.state, taken_back={"previous": {"colour": 1}})
    with pytest.raises(ReplayError, match="cannot read"):
        carry_over.with_state(workflow)
