"""Archives of journals that come from another machine: Parquet files, their rows, and the catalogue.

python -m fuzz.archives -max_total_time=60
"""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
import struct
import tempfile
from contextlib import closing, suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from fuzz.running import instrumented, run

with instrumented("pcmrs.archive", "pcmrs.journal"):
    from pcmrs.archive import add_journal, open_store, verify_archive
    from pcmrs.archive.answer import rows_of
    from pcmrs.errors import ArchiveError
    from pcmrs.files import sha256_of
    from pcmrs.journal import Journal, JournalRow
    from pcmrs.journal.rows import GENESIS, chain_hash
    from pcmrs.messages import BlueprintTag

FOLDER = tempfile.TemporaryDirectory(prefix="fuzz-archives-")
CATALOGUE = "catalogue.sqlite"
BEGIN = b"-----BEGIN"
QUESTION = "SELECT * FROM rows"
ROW = JournalRow(
    kind="config",
    wall=1.7e9,
    monotonic=12.5,
    boot_id="boot",
    session_id="session",
    blueprint=BlueprintTag(id="ratms", version="1", hash="ab" * 32),
    operation="started",
    result={"settings": {"cell": {"site": "lab", "name": "cell1"}}},
)


def make_archive(folder: Path) -> Path:
    """Return the folder of an archive with one journal of one row.

    Args:
        folder: Folder for the journal and the archive.
    """

    async def write() -> None:
        journal = Journal.open(folder / "cell1" / "ratms.sqlite", durable=False)
        await journal.append([ROW])
        await journal.close()

    (folder / "cell1").mkdir()
    asyncio.run(write())
    with closing(open_store(str(folder / "archive"), make=True)) as store:
        add_journal(store, folder / "cell1" / "ratms.sqlite")
    return folder / "archive"


ARCHIVE = make_archive(Path(FOLDER.name))
(PARQUET,) = (path.relative_to(ARCHIVE) for path in ARCHIVE.rglob("*.parquet"))


def one(data: bytes) -> None:
    """Verify and ask an archive in which the input has replaced something; the first byte selects what.

    The Parquet file, some of its bytes, the row with its hashes, entries of the catalogue, or the catalogue. The
    entries have the hash of a replaced file, since anyone who can replace one can replace both.
    """
    archive = Path(FOLDER.name, "altered")
    shutil.rmtree(archive, ignore_errors=True)
    shutil.copytree(ARCHIVE, archive)
    kind, rest = data[:1], data[1:]
    parquet = archive / PARQUET
    if kind < b"\x40":
        parquet.write_bytes(rest)
    elif kind < b"\x80":
        whole = parquet.read_bytes()
        place = int.from_bytes(rest[:2]) % len(whole)
        parquet.write_bytes(whole[:place] + rest[2:] + whole[place + len(rest[2:]) :])
    elif kind < b"\xc0":
        replace_row(archive, rest)
    elif kind < b"\xe0":
        replace_entries(archive, rest)
    else:
        (archive / CATALOGUE).write_bytes(rest)
    if kind < b"\xc0":
        with closing(sqlite3.connect(archive / CATALOGUE)) as catalogue, catalogue:
            catalogue.execute("PRAGMA synchronous = OFF")
            catalogue.execute("UPDATE segments SET bytes = ?, sha256 = ?", (parquet.stat().st_size, sha256_of(parquet)))
    read(archive, asked=bool(kind) and kind[0] % 16 == 0)


def replace_row(archive: Path, body: bytes) -> None:
    """Replace the only row, with its hash in the Parquet file and in the catalogue.

    Args:
        archive: Folder of the archive.
        body: Body of the row.
    """
    table, own = pq.read_table(archive / PARQUET), chain_hash(GENESIS, 1, body)
    for name, value in (("body", body), ("hash", own)):
        place = table.schema.get_field_index(name)
        table = table.set_column(place, table.schema.field(place), pa.array([value], pa.binary()))
    pq.write_table(table, archive / PARQUET)
    with closing(sqlite3.connect(archive / CATALOGUE)) as catalogue, catalogue:
        catalogue.execute("PRAGMA synchronous = OFF")
        catalogue.execute("UPDATE segments SET last_hash = ?", (own,))


def replace_entries(archive: Path, data: bytes) -> None:
    """Replace the range of the segment, the head and the key: two integers, then the head, then the key as PEM.

    Args:
        archive: Folder of the archive.
        data: Fuzzed bytes.
    """
    start, last = struct.unpack("<qq", data[:16].ljust(16, b"\0"))
    head, mark, key = data[16:].partition(BEGIN)
    parquet = archive / PARQUET
    parquet.rename(parquet.with_name(f"{start + 1:012d}.parquet"))
    with closing(sqlite3.connect(archive / CATALOGUE)) as catalogue, catalogue:
        catalogue.execute("PRAGMA synchronous = OFF")
        catalogue.execute("UPDATE segments SET start = ?, last = ?", (start, last))
        catalogue.execute("UPDATE journals SET head = ?", (head,))
        if mark:
            catalogue.execute("UPDATE journals SET key = ?", (mark + key,))


def read(archive: Path, *, asked: bool) -> None:
    """Verify an archive, and ask it for all rows.

    Args:
        archive: Its folder.
        asked: True to ask it, which takes much longer.
    """
    with suppress(ArchiveError), closing(open_store(str(archive))) as store:
        verify_archive(store)
    if asked:
        with suppress(ArchiveError), closing(open_store(str(archive))) as store, store.ask(QUESTION) as answer:
            for _ in rows_of(answer):
                pass


if __name__ == "__main__":
    run(one)
