"""`pcmrs journal show`: which rows are shown, in which order."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Command, Reason, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from tests.unit.cli.command_line import run
from tests.unit.cli.journals import journal_command, rows_of


def _write_journal(folder: Path) -> Path:
    async def write() -> None:
        journal = Journal.open(folder / "ratms.sqlite", durable=False)
        recorder = JournalRecorder(journal, SystemClock(), "session", BlueprintTag(id="ratms", version="1", hash="0"))
        for number in range(3):
            command = Command(id=f"c{number}", branch="robot", operation="connect", source="bus:local")
            refused = Reason(code="silent", text="The robot is silent.")
            verdict = Verdict(
                id=command.id,
                branch="robot",
                operation="connect",
                decision="failed",
                state="0",
                sequence=1,
                reason=refused,
            )
            await recorder.decision(command, verdict, {"robot": "0"}, {}, with_intent=True)
        await journal.close()

    asyncio.run(write())
    return folder / "ratms.sqlite"


def test_journal_is_shown_oldest_first_and_only_its_last_rows(tmp_path: Path) -> None:
    path = _write_journal(tmp_path)
    shown = run("journal", "show", str(path))
    assert shown.exit_code == 0
    lines = shown.stdout.splitlines()
    assert len(lines) == 6
    assert "robot.connect" in lines[0]
    assert "failed: The robot is silent." in lines[1]
    last = run("journal", "show", str(path), "--last", "2", "--json")
    rows = [json.loads(line) for line in last.stdout.splitlines()]
    assert [row["row"]["command_id"] for row in rows] == ["c2", "c2"]


def test_a_journal_that_is_not_there_is_named(tmp_path: Path) -> None:
    ended = run("journal", "show", str(tmp_path / "none.sqlite"))
    assert ended.exit_code == 5
    (line,) = ended.stderr.splitlines()
    assert "none.sqlite" in line


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
    journal_path: Path, tmp_path: Path, filters: list[str], sequences: list[int]
) -> None:
    shown = journal_command("show", journal_path, "--json", *filters)
    assert [json.loads(line)["sequence"] for line in shown.stdout.splitlines()] == sequences
    if "--last" not in filters:
        for more in ([], ["--good-part"]):
            exported = tmp_path / "rows.jsonl"
            assert journal_command("export", journal_path, "-o", exported, *filters, *more).exit_code == 0
            assert exported.read_text() == shown.stdout


def test_a_journal_can_be_followed_while_it_is_written(journal_path: Path) -> None:
    words = ["journal", "show", str(journal_path), "--last", "1", "--follow", "--json"]
    command = [sys.executable, "-m", "pcmrs.cli", *words]
    unbuffered = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=unbuffered) as shown:
        assert shown.stdout is not None
        assert json.loads(shown.stdout.readline())["sequence"] == 12

        async def write() -> None:
            journal = Journal.open(journal_path, durable=False)
            await journal.append(rows_of(4))
            await journal.close()

        asyncio.run(write())
        assert [json.loads(shown.stdout.readline())["sequence"] for _ in range(3)] == [13, 14, 15]
        shown.send_signal(signal.SIGINT)
        assert shown.wait(30) == 130
