"""Processes whose disk fails: nothing is acknowledged that it has not, and what it has is found out."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from pcmrs.journal import JournalReader, verify
from tests import ROOT

needs_strace = pytest.mark.skipif(shutil.which("strace") is None, reason="strace has system calls fail")


PROGRAM = """
import asyncio, json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from tests.unit.journal.journal_rows import row
from pcmrs.errors import JournalError
from pcmrs.journal import Journal, writer

writer._CHECKPOINT_AFTER = 6

async def main():
    journal = Journal.open(Path(sys.argv[1]))
    acknowledged, failed, reopened, waited, told = [], None, None, 0.0, []
    journal.on_failure(lambda error: told.append(error.text))
    for number in range(16):
        appended = asyncio.ensure_future(journal.append([row(result={"number": number})]))
        while not appended.done():
            await asyncio.sleep(0.001)
            waited = max(waited, journal.oldest_wait)
        try:
            acknowledged.append([number, appended.result()])
        except JournalError as error:
            failed = [number, error.fields["sequence"]]
            break
        await asyncio.sleep(0.005)
        if journal.broken is not None:
            break
    if journal.broken is not None:
        async with asyncio.timeout(10.0):
            while not told:
                await asyncio.sleep(0.001)
        try:
            await journal.append([row()])
            raise SystemExit("appended to a broken journal")
        except JournalError:
            pass
        try:
            reopened = await journal.reopen()
            acknowledged.append([99, await journal.append([row(result={"number": 99})])])
        except JournalError as error:
            reopened = error.text
    await journal.close()
    print(json.dumps({"acknowledged": acknowledged, "failed": failed, "reopened": reopened, "waited": waited}))

asyncio.run(main())
"""


def run(path: Path, suffix: str, inject: str) -> dict[str, Any]:
    """Runs the program with a system call of its writer's thread on one of its files failing or held up."""
    call = inject.partition(":")[0]
    options = ["-f", "-qq", "-o", "/dev/null", "-e", f"trace={call}", "-e", f"inject={inject}", "-P", f"{path}{suffix}"]
    program = [sys.executable, "-c", PROGRAM, str(path), str(ROOT)]
    ended = subprocess.run(["strace", *options, *program], check=True, capture_output=True, text=True, timeout=100)
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def numbers(path: Path) -> dict[int, int]:
    """The number in each row, to its sequence."""
    with JournalReader(path) as reader:
        rows = [(stored.row.result or {}, stored.sequence) for stored in reader.read()]
    return {result["number"]: sequence for result, sequence in rows if "number" in result}


def stored_text(path: Path) -> str:
    """What the journal says of its reopening."""
    with JournalReader(path) as reader:
        (stored,) = reader.read(source="journal")
    return str((stored.row.result or {})["text"])


@needs_strace
@pytest.mark.parametrize(
    ("suffix", "inject"),
    [
        ("-wal", "pwrite64:error=ENOSPC:when=9"),
        ("-wal", "pwrite64:error=EIO:when=14"),
        ("-wal", "pwrite64:error=EROFS:when=8"),
        ("-wal", "fdatasync:error=EIO:when=4"),
        (".head", "pwrite64:error=EIO:when=5"),
        (".head", "fdatasync:error=EIO:when=3"),
        ("", "fdatasync:error=EIO:when=1"),
    ],
)
def test_after_an_error_of_the_disk_what_it_has_is_found_out(tmp_path: Path, suffix: str, inject: str) -> None:
    path = tmp_path / "journal.sqlite"
    found = run(path, suffix, inject)
    stored = numbers(path)
    assert found["acknowledged"][-1][0] == 99
    assert {number: stored[number] for number, _ in found["acknowledged"]} == dict(found["acknowledged"])
    number, sequence = found["failed"] or (None, None)
    # A checkpoint comes after what it carries over is acknowledged: a row that is appended meanwhile is not written.
    assert (sequence is None) == (suffix == "")
    assert (number in stored) == (sequence is not None and sequence <= found["reopened"])
    assert "cannot be written" in stored_text(path)
    assert verify(path).sound


@needs_strace
def test_nothing_is_acknowledged_while_the_disk_fails(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    found = run(path, ".head", "fdatasync:error=EIO:when=3+")
    assert "cannot be written" in found["reopened"]
    assert dict(found["acknowledged"]).keys() == {0, 1}
    assert dict(found["acknowledged"]).items() <= numbers(path).items()


@needs_strace
def test_a_disk_that_stalls_is_waited_for(tmp_path: Path) -> None:
    found = run(tmp_path / "journal.sqlite", "-wal", "fdatasync:delay_enter=700000:when=4")
    assert [sequence for _, sequence in found["acknowledged"]] == list(range(1, 17))
    assert found["waited"] > 0.5
