"""A writer that is killed while the journal goes on in a new file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.failpoints import ROTATION_FAILPOINTS, VARIABLE
from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.journal.notes import SOURCE
from pcmrs.journal.reader import journal_files
from tests import ROOT

WRITER = """
import asyncio, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from tests.unit.journal.journal_rows import row
from pcmrs.journal import Journal, writer
writer._CHECKPOINT_AFTER = 3

async def main():
    journal = Journal.open(Path(sys.argv[1]), largest=1.0)
    while True:
        print(await journal.append([row()]), flush=True)

asyncio.run(main())
"""


def killed_at(path: Path, failpoint: str) -> list[int]:
    """What a writer has acknowledged that died there."""
    arguments = [sys.executable, "-c", WRITER, str(path), str(ROOT)]
    environment = {**os.environ, VARIABLE: failpoint}
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=60, env=environment, check=False)
    assert ended.returncode == -signal.SIGKILL
    return [int(line) for line in ended.stdout.splitlines()]


@pytest.mark.parametrize("name", ROTATION_FAILPOINTS)
@pytest.mark.parametrize("growth", [1, 2])
async def test_kill_while_a_file_is_started_loses_no_acknowledged_row(tmp_path: Path, name: str, growth: int) -> None:
    path = tmp_path / "journal.sqlite"
    acknowledged = killed_at(path, f"{name}:{growth}")
    assert acknowledged

    assert verify(path).sound
    await Journal.open(path).close()
    assert verify(path).unnamed == 0
    with JournalReader(path) as reader:
        stored = list(reader.read())
    assert [item.sequence for item in stored] == list(range(1, len(stored) + 1))
    assert set(acknowledged) <= {item.sequence for item in stored if item.row.source != SOURCE}
    behind = [item.row.operation for item in stored if item.row.operation == "head_behind"]
    assert behind == (["head_behind"] if name == "journal.after_next_file" else [])
    assert len(journal_files(path)) == growth + (name != "journal.before_next_file")
