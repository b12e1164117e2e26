"""A killed writer loses no row that it acknowledged, and leaves a journal that is taken up, wherever it died."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.failpoints import FAILPOINTS, VARIABLE
from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.journal.notes import SOURCE
from tests import ROOT

WRITER = """
import asyncio, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from tests.unit.journal.journal_rows import row
from pcmrs.journal import Journal

async def main():
    journal = Journal.open(Path(sys.argv[1]), durable=sys.argv[3] == "True")
    async def client(name):
        while True:
            print(await journal.append([row(result={"client": name})]), flush=True)
            await asyncio.sleep(0)
    await asyncio.gather(*(client(name) for name in range(8)))

asyncio.run(main())
"""


IN_JOURNAL = [name for name in FAILPOINTS if name.startswith("journal.")]


def start(path: Path, *, durable: bool = True, failpoint: str = "") -> subprocess.Popen[str]:
    arguments = [sys.executable, "-c", WRITER, str(path), str(ROOT), str(durable)]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env={**os.environ, VARIABLE: failpoint})


def kill_after(path: Path, rows: int, *, durable: bool) -> list[int]:
    """Kills a writer once it has acknowledged so many rows; returns all that it acknowledged."""
    with start(path, durable=durable) as writer:
        assert writer.stdout is not None
        acknowledged = [int(writer.stdout.readline()) for _ in range(rows)]
        writer.kill()
        # What was acknowledged until the kill is still in the pipe; the last line may be cut.
        return acknowledged + [int(line) for line in writer.stdout if line.endswith("\n")]


async def check(path: Path, acknowledged: list[int]) -> list[str]:
    """Takes the journal up; returns what the journal says of itself."""
    killed = verify(path)
    assert killed.sound
    assert killed.signed >= max(acknowledged), "a row was acknowledged that the head does not name"
    await Journal.open(path).close()
    assert verify(path).unnamed == 0
    with JournalReader(path) as reader:
        stored = list(reader.read())
    assert [item.sequence for item in stored] == list(range(1, len(stored) + 1))
    assert len(acknowledged) == len(set(acknowledged))
    assert set(acknowledged) <= {item.sequence for item in stored if item.row.source != SOURCE}
    return [item.row.operation or "" for item in stored if item.row.source == SOURCE]


@pytest.mark.parametrize("durable", [True, False])
async def test_kill_loses_no_acknowledged_row(tmp_path: Path, durable: bool) -> None:
    path = tmp_path / "journal.sqlite"
    acknowledged: list[int] = []
    for after in (50, 200):
        acknowledged += kill_after(path, after, durable=durable)
    await check(path, acknowledged)


@pytest.mark.parametrize("name", IN_JOURNAL)
async def test_kill_at_a_named_place_loses_no_acknowledged_row(tmp_path: Path, name: str) -> None:
    path = tmp_path / "journal.sqlite"
    fatal = random.Random(name).randint(2, 6)
    with start(path, failpoint=f"{name}:{fatal}") as writer:
        assert writer.stdout is not None
        acknowledged = [int(line) for line in writer.stdout if line.endswith("\n")]
    assert writer.returncode == -signal.SIGKILL
    assert acknowledged
    # Only between a commit and the head are there rows that the head does not name.
    assert await check(path, acknowledged) == (["head_behind"] if name == "journal.after_commit" else [])


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("durable", [True, False])
async def test_many_kills_lose_no_acknowledged_row(tmp_path: Path, durable: bool) -> None:
    path, chance = tmp_path / "journal.sqlite", random.Random(1)
    acknowledged: list[int] = []
    for _ in range(100):
        acknowledged += kill_after(path, chance.randint(1, 300), durable=durable)
        assert verify(path).sound
    await check(path, acknowledged)
