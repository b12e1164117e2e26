"""The system calls by which a process writes its files, recorded by strace, and what a power cut leaves of them."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pcmrs.campaign.fault import NotRun
from pcmrs.journal import JournalReader, StoredRow

CALLS = "pwrite64,write,fsync,fdatasync,ftruncate"
SECTOR = 512
TOLD = "told"
"""File to which the writer writes one byte for every row that was acknowledged."""

_LINE = re.compile(r"^(\d+) +(\w+)\(\d+<([^>]*)>(?:, (.*))?\) += (-?\d+)")
_BEGUN = re.compile(r"^(\d+) +(\w+\(.*) <unfinished \.\.\.>$")
_RESUMED = re.compile(r"^(\d+) +<\.\.\. \w+ resumed>(.*)$")
_WRITTEN = re.compile(r'^"((?:\\x[0-9a-f]{2})*)"(\.\.\.)?, \d+(?:, (\d+))?$')


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing done to one file.

    Attributes:
        kind: ``write``, ``sync``, ``cut`` or ``told``.
        file: Its name.
        data: Written.
        place: Where it is written, or the size that is left.
    """

    kind: str
    file: str
    data: bytes = b""
    place: int = 0


def record(
    base: Path, folder: Path, commits: int, seed: int, *, durable: bool = True
) -> tuple[list[Operation], list[StoredRow]]:
    """Has a process write on a copy of the journal in `base`, and records what it does to its files.

    Args:
        base: Folder of a journal.
        folder: Made for the copy.
        commits: So many are written.
        seed: Of their sizes.
        durable: False for a writer that waits for no disk: the control, which a power cut must be seen to harm.

    Returns:
        The operations in order, and the rows that the journal has at the end; those of `base` were all acknowledged.

    Raises:
        NotRun: There is no strace, or it may not trace.
    """
    shutil.copytree(base, folder)
    trace = folder.with_suffix(".trace")
    words = ["strace", "-f", "-y", "-xx", "-s", "70000", "-qq", "-e", f"trace={CALLS}", "-o", str(trace)]
    program = [sys.executable, "-m", "pcmrs.campaign.writing", str(folder), str(commits), str(seed)]
    program.append("durable" if durable else "careless")
    try:
        run = subprocess.run([*words, *program], capture_output=True, text=True, check=False)
    except OSError as error:
        raise NotRun(f"strace cannot be run: {error.strerror}; `make tools` installs what faults need.") from None
    if run.returncode != 0:
        raise NotRun(f"strace cannot record here: {run.stderr.strip()[-500:]}")
    with trace.open(errors="replace") as lines, JournalReader(folder / "journal.sqlite") as reader:
        return list(_operations(lines, folder)), list(reader.read())


def after_power_cut(base: Path, done: Sequence[Operation], folder: Path, generator: random.Random) -> int:
    """Makes in `folder` what a disk may have after these operations; returns how many rows were acknowledged."""
    shutil.copytree(base, folder)
    with JournalReader(folder / "journal.sqlite") as reader:
        acknowledged = max((stored.sequence for stored in reader.read(last=1)), default=0)
    for shared in folder.glob("*-shm"):
        shared.unlink()
    contents = {file.name: bytearray(file.read_bytes()) for file in base.iterdir() if not file.name.endswith("-shm")}
    for number, operation in enumerate(done):
        if operation.kind == TOLD:
            acknowledged += len(operation.data)
        elif operation.kind != "sync":
            synchronised = any(later.kind == "sync" and later.file == operation.file for later in done[number + 1 :])
            _apply(contents.setdefault(operation.file, bytearray()), operation, generator, certain=synchronised)
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return acknowledged


def _apply(content: bytearray, operation: Operation, generator: random.Random, *, certain: bool) -> None:
    """What is not certain reached the disk, or did not, or did so up to a sector."""
    if operation.kind == "cut":
        if certain or generator.random() < 0.5:
            del content[operation.place :]
        return
    data = operation.data
    if not certain:
        whole = generator.random()
        data = data if whole < 0.4 else data[: generator.randrange(len(data) // SECTOR + 1) * SECTOR]
    if data:
        if len(content) < operation.place:
            content.extend(bytes(operation.place - len(content)))
        content[operation.place : operation.place + len(data)] = data


def _operations(lines: Iterator[str], folder: Path) -> Iterator[Operation]:
    begun: dict[str, str] = {}
    for raw in lines:
        line = raw.rstrip("\n")
        if match := _BEGUN.match(line):
            begun[match[1]] = f"{match[1]} {match[2]}"
            continue
        if match := _RESUMED.match(line):
            line = begun.pop(match[1], "") + match[2]
        operation = _operation(line, folder)
        if operation is not None:
            yield operation


def _operation(line: str, folder: Path) -> Operation | None:
    match = _LINE.match(line)
    if match is None or int(match[5]) < 0:
        return None
    path = Path(bytes.fromhex(match[3].replace("\\x", "")).decode() if match[3].startswith("\\x") else match[3])
    if path.parent != folder or path.name.endswith("-shm"):
        return None
    if match[2] in ("fsync", "fdatasync"):
        return Operation("sync", path.name)
    if match[2] == "ftruncate":
        return Operation("cut", path.name, place=int(match[4]))
    written = _WRITTEN.match(match[4])
    if written is None or written[2]:
        raise NotRun(f"strace recorded {line[:200]}, which cannot be read.")
    data = bytes.fromhex(written[1].replace("\\x", ""))
    return Operation(TOLD if path.name == TOLD else "write", path.name, data, int(written[3] or 0))
