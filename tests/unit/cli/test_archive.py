"""`pcmrs archive`: journals of several cells are added, listed, verified and asked."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from tests.unit.archive.archives import commands, config, write
from tests.unit.cli.journals import damage


@pytest.fixture
def cells(tmp_path: Path) -> list[Path]:
    """Journals of two cells."""
    return [write(tmp_path / name / "ratms.sqlite", [config("lab", name), *commands(2)]) for name in ("c1", "c2")]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    return tmp_path / "archive"


def run(place: Path, *words: object) -> Result:
    command = ["archive", *(str(word) for word in words)]
    return CliRunner().invoke(main, command, env={"PCMRS_ARCHIVE": str(place)})


def test_journals_are_added_and_verified(place: Path, cells: list[Path]) -> None:
    added = run(place, "add", *cells)
    assert (added.exit_code, added.stdout.count("7 rows added, 7 in the archive")) == (0, 2), added.output
    again = [json.loads(line) for line in run(place, "add", *cells, "--json").stdout.splitlines()]
    assert [(each["added"], each["rows"]) for each in again] == [(0, 7), (0, 7)]
    verified = run(place, "verify")
    assert verified.exit_code == 0
    assert "lab/c1/ratms-" in verified.stdout
    listed = json.loads(run(place, "list", "--json").stdout)
    assert [(each["journal"][:7], each["segments"], each["rows"]) for each in listed] == [
        ("lab/c1/", 1, 7),
        ("lab/c2/", 1, 7),
    ]
    assert "pcmrs archive ask stops: Who stopped what" in run(place, "list").stdout


def test_the_journal_of_the_configured_cell_is_added(place: Path, tmp_path: Path) -> None:
    write(tmp_path / "mine" / "ratms.sqlite", [config("lab", "mine")])
    added = run(place, "add", "--set", f"cell.folder={tmp_path / 'mine'}")
    assert added.stdout.startswith("lab/mine/ratms-"), added.output


def test_one_damaged_journal_does_not_keep_the_others_out(place: Path, cells: list[Path]) -> None:
    damage(cells[0], 3)
    added = run(place, "add", *cells)
    assert added.exit_code == 5
    assert "c1/ratms.sqlite was not added" in added.stderr
    assert "row 3" in added.stderr
    assert "lab/c2/ratms-" in added.stdout


def test_a_cell_is_named_by_the_user(place: Path, tmp_path: Path) -> None:
    path = write(tmp_path / "old" / "ratms.sqlite", commands(1))
    refused = run(place, "add", path)
    assert (refused.exit_code, "--cell SITE/NAME" in refused.stderr) == (5, True)
    assert run(place, "add", path, "--cell", "oslo/c9").stdout.startswith("oslo/c9/ratms-")
    assert "is not a cell" in run(place, "add", path, "--cell", "oslo").stderr


def test_a_damaged_archive_is_reported_and_not_asked(place: Path, cells: list[Path]) -> None:
    run(place, "add", *cells)
    next(place.rglob("c1/*/*.parquet")).unlink()
    verified = run(place, "verify", "--json")
    assert verified.exit_code == 1
    (problem,) = json.loads(verified.stdout)["problems"]
    assert problem["code"] == "segment_missing"
    assert "PROBLEM Rows 1–7 of lab/c1/" in run(place, "verify").stdout
    asked = run(place, "ask", "sessions")
    assert asked.exit_code == 5
    assert "Rows 1–7 of lab/c1/ratms" in asked.stderr


def test_a_kept_key_is_compared(place: Path, cells: list[Path]) -> None:
    run(place, "add", *cells)
    keys = [cell.with_name("journal.pub") for cell in cells]
    assert run(place, "verify", "--public-key", "lab/c1", keys[0]).exit_code == 0
    assert run(place, "verify", "--public-key", "lab/c1", keys[1]).exit_code == 1


def test_questions_are_answered_as_table_lines_and_file(place: Path, cells: list[Path], tmp_path: Path) -> None:
    run(place, "add", *cells)
    assert "cell  " in run(place, "ask", "sessions").stdout
    rows = [json.loads(line) for line in run(place, "ask", "sessions", "--json").stdout.splitlines()]
    assert [(row["site"], row["cell"], row["rows"]) for row in rows] == [("lab", "c1", 7), ("lab", "c2", 7)]
    output = tmp_path / "rows.parquet"
    exported = run(place, "ask", "--sql", "SELECT * FROM rows", "-o", output)
    assert exported.stdout == f"14 rows in {output}.\n"
    assert pq.read_table(output).num_rows == 14


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        ((), 2, "one of QUESTION and --sql"),
        (("stops", "--sql", "SELECT 1"), 2, "one of QUESTION and --sql"),
        (("stop",), 2, "There is no question stop"),
        (("--sql", "DROP TABLE rows"), 5, "one SELECT"),
        (("--sql", "SELECT * FROM rows", "-o", "rows.xlsx"), 5, ".parquet or .csv"),
    ],
)
def test_what_is_no_question_is_refused(
    place: Path, cells: list[Path], words: tuple[str, ...], status: int, message: str
) -> None:
    run(place, "add", *cells)
    refused = run(place, "ask", *words)
    assert (refused.exit_code, message in refused.stderr) == (status, True), refused.output


def test_a_place_without_an_archive_is_named(place: Path) -> None:
    for words in (("list",), ("verify",), ("ask", "stops")):
        refused = run(place, *words)
        assert refused.exit_code == 5
        assert f"{place} is not an archive" in refused.stderr
    assert not place.exists()
