"""A power cut at any instant loses no row that was acknowledged, and leaves a journal that is taken up."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from damaged import NAME, place
from power_cut import cuts, record

from pcmrs.journal import Journal, JournalReader, verify

pytestmark = pytest.mark.skipif(shutil.which("strace") is None, reason="strace records what is written")

WRITER = """
import asyncio, os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from journal_rows import row
from pcmrs.journal import Journal, writer

writer._CHECKPOINT_AFTER = 4

async def main():
    for _ in range(2):
        journal = Journal.open(Path(sys.argv[1]), durable=sys.argv[3] == "True")
        async def client(name):
            for _ in range(8):
                sequence = await journal.append([row(result={"client": name})])
                os.write(1, b"%d\\n" % sequence)
        await asyncio.gather(*(client(name) for name in range(3)))
        await journal.close()

asyncio.run(main())
"""


async def lost(folder: Path, times: int, seed: int, *, durable: bool) -> int:
    """Cuts the power so many times; returns in how many of them an acknowledged row was lost."""
    written, left = folder / "written", folder / "left"
    written.mkdir()
    calls = record(written, WRITER, str(written / NAME), str(Path(__file__).parent), str(durable))
    found = 0
    for instant, files, acknowledged in cuts(written, calls, times, seed):
        path = place(files, left)
        if durable:
            await Journal.open(path, durable=False).close()
            assert verify(path).sound, instant
        found += len(set(acknowledged) - _sequences(path)) > 0
    return found


def _sequences(path: Path) -> set[int]:
    try:
        with JournalReader(path) as reader:
            return {stored.sequence for stored in reader.read()}
    except Exception:
        return set()


async def test_a_power_cut_loses_no_acknowledged_row(tmp_path: Path) -> None:
    assert await lost(tmp_path, 60, 1, durable=True) == 0


async def test_the_cuts_would_show_a_journal_that_does_not_wait_for_the_disk(tmp_path: Path) -> None:
    assert await lost(tmp_path, 20, 1, durable=False) > 5


@pytest.mark.nightly
@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", range(4))
async def test_a_thousand_power_cuts_lose_no_acknowledged_row(tmp_path: Path, seed: int) -> None:
    assert await lost(tmp_path, 250, seed, durable=True) == 0
