"""Process that writes a journal until it is killed or has done its part, and reports every acknowledged row."""

from __future__ import annotations

import asyncio
import os
import random
import struct
import sys
from pathlib import Path
from typing import Final

from pcmrs.errors import JournalError
from pcmrs.failpoints import arm
from pcmrs.journal import Journal
from pcmrs.testing.journal import row

SEQUENCE = struct.Struct("<Q")
REFUSED = (1 << 64) - 1
"""Sent in place of a sequence if the journal cannot be opened; the error's text follows."""
PARALLEL = 3
"""Number of concurrent writers, like parallel branches."""
SESSIONS = 2
"""Number of times that a recorded journal is opened."""


def write(path: Path, run: str, seed: int, failpoint: str, descriptor: int) -> None:
    """Open the journal, and write until killed.

    Args:
        path: Database file of the journal.
        run: Session id, unique to this process.
        seed: Seed of the order of the writers.
        failpoint: ``name:N``, or empty.
        descriptor: Descriptor to which 0 is written first, then the sequence of every acknowledged row.
    """
    arm(failpoint)
    asyncio.run(_write(path, run, random.Random(seed), descriptor))


async def _write(path: Path, run: str, generator: random.Random, descriptor: int) -> None:
    os.write(descriptor, SEQUENCE.pack(0))
    try:
        journal = Journal.open(path)
    except JournalError as error:
        os.write(descriptor, SEQUENCE.pack(REFUSED) + error.text.encode())
        return

    async def one(writer: int) -> None:
        number = 0
        while True:
            rows = [row(run, writer, number + each) for each in range(generator.randrange(1, 4))]
            number += len(rows)
            os.write(descriptor, SEQUENCE.pack(await journal.append(rows)))
            if generator.random() < 0.1:
                await asyncio.sleep(0.001)

    await asyncio.gather(*map(one, range(PARALLEL)))


GROWN: Final = 1.0
"""Size limit of a file, bytes; every file exceeds it, so that each session continues in a new one."""


async def _write_some(path: Path, commits: int, generator: random.Random, *, durable: bool) -> None:
    """Commit groups of rows, in a new file in each session; print the acknowledged sequences."""
    for run in range(SESSIONS):
        journal = Journal.open(path, durable=durable, largest=GROWN)

        async def one(writer: int, journal: Journal = journal, run: int = run) -> None:
            for number in range(commits // (SESSIONS * PARALLEL)):
                group = [row(f"run{run}", writer, number)] * generator.randrange(1, 3)
                last = await journal.append(group)
                lines = [b"%d\n" % sequence for sequence in range(last - len(group) + 1, last + 1)]
                os.write(1, b"".join(lines))

        await asyncio.gather(*map(one, range(PARALLEL)))
        await journal.close()


def main() -> None:
    """Write a journal in a folder: ``FOLDER COMMITS SEED durable|careless``."""
    folder, commits, seed, care = sys.argv[1:]
    path = Path(folder) / "journal.sqlite"
    asyncio.run(_write_some(path, int(commits), random.Random(int(seed)), durable=care == "durable"))


if __name__ == "__main__":
    main()
