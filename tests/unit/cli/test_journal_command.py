"""`pcmrs journal`: what is shown, proven and exported, and how a damaged journal is told."""

from __future__ import annotations

import asyncio
import csv
import json
import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag, Reason, Verdict

COMMON: dict[str, Any] = {
    "wall": 1.7e9,
    "monotonic": 1.0,
    "boot_id": "boot",
    "session_id": "s",
    "blueprint": BlueprintTag(id="ratms", version="1", hash="0"),
}


def _rows(number: int) -> list[JournalRow]:
    command: dict[str, Any] = {
        "command_id": f"c{number}",
        "source": "bus:local",
        "branch": "robot",
        "operation": "connect",
    }
    reason = Reason(code="silent", text="The robot, alas, is silent.")
    told: dict[str, Any] = {"id": f"c{number}", "branch": "robot", "operation": "connect", "state": "0", "sequence": 1}
    verdict = Verdict(decision="failed", reason=reason, **told)
    arguments = {"speed": 0.1, "text": 'with "quotes", commas\nand lines'}
    return [
        JournalRow(kind="intent", arguments=arguments, **command, **COMMON),
        JournalRow(kind="outcome", verdict=verdict, states={"robot": "0"}, **command, **COMMON),
        JournalRow(kind="device", source="robot", operation="link_lost", result={"text": "Gone."}, **COMMON),
    ]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    async def write() -> None:
        journal = Journal.open(tmp_path / "ratms.sqlite", durable=False)
        for number in range(4):
            await journal.append(_rows(number))
        await journal.close()

    asyncio.run(write())
    return tmp_path / "ratms.sqlite"


def _run(*words: object) -> Result:
    return CliRunner().invoke(main, ["journal", *(str(word) for word in words)])


def _damage(path: Path, sequence: int) -> None:
    with sqlite3.connect(path) as connection:
        (guard,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_update'").fetchone()
        connection.execute("DROP TRIGGER no_update")
        connection.execute("UPDATE journal SET body = x'00' WHERE sequence = ?", (sequence,))
        connection.execute(guard)
    connection.close()


@pytest.mark.parametrize(
    ("filters", "sequences"),
    [
        (["--kind", "device"], [3, 6, 9, 12]),
        (["--branch", "robot", "--last", "3"], [8, 10, 11]),
        (["--source", "robot", "--last", "2"], [9, 12]),
        (["--command", "c1"], [4, 5]),
        (["--kind", "outcome", "--command", "c1"], [5]),
        (["--branch", "nowhere"], []),
    ],
)
def test_rows_can_be_chosen_when_shown_and_when_exported(
    path: Path, tmp_path: Path, filters: list[str], sequences: list[int]
) -> None:
    shown = _run("show", path, "--json", *filters)
    assert [json.loads(line)["sequence"] for line in shown.stdout.splitlines()] == sequences
    if "--last" not in filters:
        for more in ([], ["--good-part"]):
            exported = tmp_path / "rows.jsonl"
            assert _run("export", path, "-o", exported, *filters, *more).exit_code == 0
            assert exported.read_text() == shown.stdout


def test_a_table_holds_what_the_rows_hold(path: Path, tmp_path: Path) -> None:
    exported = tmp_path / "rows.csv"
    assert _run("export", path, "-o", exported).exit_code == 0
    with exported.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["sequence"]) for row in rows] == list(range(1, 13))
    assert json.loads(rows[0]["arguments"]) == _rows(0)[0].arguments
    assert rows[1]["decision"] == "failed"
    assert rows[1]["reason"] == "silent"
    assert rows[1]["time"] == "2023-11-14T22:13:20.000+00:00"
    assert rows[2]["command_id"] == ""


def test_a_whole_journal_is_proven(path: Path) -> None:
    shown = _run("verify", path)
    assert shown.exit_code == 0
    assert "12 rows are proven" in shown.stdout
    report = json.loads(_run("verify", path, "--json").stdout)
    assert (report["rows"], report["signed"], report["signature"], report["problems"]) == (12, 12, "holds", [])


def test_the_first_bad_row_is_named_and_the_good_part_is_saved(path: Path, tmp_path: Path) -> None:
    _damage(path, 8)
    shown = _run("verify", path, "--json")
    assert shown.exit_code == 1
    assert json.loads(shown.stdout)["first_bad"] == 8
    exported = tmp_path / "rows.jsonl"
    refused = _run("export", path, "-o", exported)
    assert refused.exit_code == 2
    assert "row 8" in refused.stderr
    assert list(tmp_path.glob("rows*")) == []
    saved = _run("export", path, "-o", exported, "--good-part")
    assert saved.exit_code == 1
    assert [json.loads(line)["sequence"] for line in exported.read_text().splitlines()] == list(range(1, 8))
    assert "row 8" in saved.stderr


def test_rows_that_are_missing_are_counted(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        (guard,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_delete'").fetchone()
        connection.execute("DROP TRIGGER no_delete")
        connection.execute("DELETE FROM journal WHERE sequence > 7")
        connection.execute(guard)
    connection.close()
    shown = _run("verify", path)
    assert shown.exit_code == 1
    assert "5 rows that the head names" in shown.stdout


def test_missing_journal_or_unknown_format_is_not_damage(path: Path, tmp_path: Path) -> None:
    assert _run("verify", tmp_path / "none.sqlite").exit_code == 2
    wrong = _run("export", path, "-o", tmp_path / "rows.txt")
    assert wrong.exit_code == 2
    assert ".jsonl or .csv" in wrong.stderr


def test_a_journal_can_be_followed_while_it_is_written(path: Path) -> None:
    command = [sys.executable, "-m", "pcmrs.cli", "journal", "show", str(path), "--last", "1", "--follow", "--json"]
    unbuffered = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=unbuffered) as shown:
        assert shown.stdout is not None
        assert json.loads(shown.stdout.readline())["sequence"] == 12

        async def write() -> None:
            journal = Journal.open(path, durable=False)
            await journal.append(_rows(4))
            await journal.close()

        asyncio.run(write())
        assert [json.loads(shown.stdout.readline())["sequence"] for _ in range(3)] == [13, 14, 15]
        shown.send_signal(signal.SIGINT)
        assert shown.wait(30) == 130
