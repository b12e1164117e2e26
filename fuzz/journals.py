"""Journals of other machines: files, heads and rows that `pcmrs journal`, exports and reports read.

python -m fuzz.journals -max_total_time=60
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import msgspec

from fuzz.running import instrumented, run

with instrumented("pcmrs.journal", "pcmrs.report.reading", "pcmrs.report.session_journal", "pcmrs.report.source"):
    from pcmrs.errors import JournalError
    from pcmrs.journal import JournalReader, StoredRow, verify
    from pcmrs.journal.export import copy_journal, csv_lines, json_lines
    from pcmrs.journal.head import head_path
    from pcmrs.journal.keys import PUBLIC
    from pcmrs.journal.rows import GENESIS, chain_hash
    from pcmrs.journal.schema import HEADLESS, INSERT, make_database
    from pcmrs.report.reading import read_report
    from pcmrs.report.source import open_source

FOLDER = tempfile.TemporaryDirectory(prefix="fuzz-journals-")
BEGIN = b"-----BEGIN"
make_database(Path(FOLDER.name, "empty.sqlite"))
EMPTY = Path(FOLDER.name, "empty.sqlite").read_bytes()


def one(data: bytes) -> None:
    """Read a journal; the first byte selects if the rest is the file, the head and its key, or rows.

    It also selects if the rows are reported.
    """
    folder = Path(FOLDER.name)
    for name in ("journal", "copied"):
        shutil.rmtree(folder / name, ignore_errors=True)
        (folder / name).mkdir()
    path, kind, rest = folder / "journal" / "ratms.sqlite", data[:1], data[1:]
    if kind < b"\x40":
        path.write_bytes(rest)
    elif kind < b"\x80":
        path.write_bytes(EMPTY)
        head, _, key = rest.partition(BEGIN)
        head_path(path).write_bytes(head)
        (path.parent / PUBLIC).write_bytes(BEGIN + key)
    else:
        write(path, rest)
    sound = read(path, folder / "copied" / "ratms.sqlite")
    with suppress(JournalError):
        # A report takes half a second, so only a few inputs are reported.
        found = read_report(path).journal if kind >= b"\xf0" else open_source(path).journal
        assert bool(found.problems) != sound


def write(path: Path, data: bytes) -> None:
    """Write a journal of version 1 with an unsigned chain: two bytes for the length of a row, then the row.

    Args:
        path: Database file to write.
        data: Fuzzed bytes.
    """
    path.write_bytes(EMPTY)
    previous, sequence = GENESIS, 0
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA synchronous = OFF")
        while len(data) > 2:
            size = int.from_bytes(data[:2])
            body, data, sequence = data[2 : 2 + size], data[2 + size :], sequence + 1
            own = chain_hash(previous, sequence, body)
            with suppress(sqlite3.Error, UnicodeEncodeError):  # for example two outcomes of one command
                connection.execute(INSERT, (sequence, *keys(body), body, previous, own))
                previous = own
        connection.execute(f"PRAGMA user_version = {HEADLESS}")
        connection.commit()
        connection.execute("PRAGMA journal_mode = DELETE")


def keys(body: bytes) -> tuple[object, ...]:
    """Return the columns of a row that repeat its fields."""
    row: object = {}
    with suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        row = msgspec.msgpack.decode(body)
    named = row if isinstance(row, dict) else {}
    kind, *others, wall = (named.get(name) for name in ("kind", "source", "command_id", "branch", "wall"))
    texts = [each if isinstance(each, str) else None for each in others]
    return kind if isinstance(kind, str) else "event", *texts, wall if isinstance(wall, float) else 0.0


def read(path: Path, copy: Path) -> bool:
    """Read and copy a journal; return whether it is sound. A copy must be as sound as the original.

    Args:
        path: Database file of the journal.
        copy: Database file of the copy.
    """
    sound = False
    with suppress(JournalError):
        sound = verify(path).sound
    with suppress(JournalError):
        copy_journal(path, copy)
        assert verify(copy).sound == sound
    rows = exported(path, json_lines)
    assert exported(path, csv_lines) == rows
    assert rows is not None or not sound or path.stat().st_size == 0  # an empty file is a journal without rows
    return sound


def exported(path: Path, form: Callable[[Iterable[StoredRow]], Iterator[str]]) -> int | None:
    """Return the number of exported rows; None if a row is damaged.

    Args:
        path: Database file of the journal.
        form: Function that formats the rows.
    """
    with suppress(JournalError), JournalReader(path) as reader:
        lines = sum(1 for _ in form(reader.read_whole()))
        return lines - 1 if form is csv_lines else lines
    return None


if __name__ == "__main__":
    run(one)
