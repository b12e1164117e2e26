"""A killed writer loses no row that it acknowledged, and leaves a whole chain."""

import subprocess
import sys
from pathlib import Path

import pytest

from pcmrs.journal import JournalReader
from pcmrs.journal.rows import GENESIS, chain_hash, encode_row

WRITER = """
import asyncio, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from journal_rows import row
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


@pytest.mark.parametrize("durable", [True, False])
def test_kill_loses_no_acknowledged_row(tmp_path: Path, durable: bool) -> None:
    path = tmp_path / "journal.sqlite"
    arguments = [sys.executable, "-c", WRITER, str(path), str(Path(__file__).parent), str(durable)]
    acknowledged: list[int] = []
    for after in (50, 200):
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout is not None
            for _ in range(after):
                acknowledged.append(int(writer.stdout.readline()))
            writer.kill()
            # What was acknowledged until the kill is still in the pipe; the last line may be cut.
            acknowledged += [int(line) for line in writer.stdout if line.endswith("\n")]
    with JournalReader(path) as reader:
        stored = list(reader.read())
    assert [item.sequence for item in stored] == list(range(1, len(stored) + 1))
    assert len(acknowledged) == len(set(acknowledged))
    assert set(acknowledged) <= {item.sequence for item in stored}
    previous = GENESIS
    for item in stored:
        previous = chain_hash(previous, item.sequence, encode_row(item.row))
        assert item.hash == previous
