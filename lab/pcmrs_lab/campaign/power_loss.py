"""State of a folder after a power cut: the worst that a disk may leave.

Of the writes to a file since its last completed fsync, any 512-byte sectors may have reached the disk, in any order. Of
the changes to the folder's names since its last fsync, any first part may have.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

SECTOR = 512
ACKNOWLEDGED = "1"
"""Descriptor to which the process writes the numbers that it acknowledges, in lines: its standard output."""

_LINE = re.compile(r"(\d+) +(\w+)\((.*)")
_ENDED = re.compile(r"(\d+) +<\.\.\. (\w+) resumed>.*= (-?\d+)")
_TEXT = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_NUMBER = re.compile(r", (\d+)(?=[,) ])")
_DESCRIPTOR = re.compile(r"(\d+)<((?:\\x[0-9a-f]{2})*)>")


@dataclass(frozen=True, slots=True)
class PowerCut:
    """State after a power cut.

    Attributes:
        call: Index of the recorded system call before which it came.
        files: Content of each file on the disk, by name.
        acknowledged: Numbers that the process had acknowledged before.
    """

    call: int
    files: dict[str, bytes]
    acknowledged: list[int]


def power_cuts(folder: Path, calls: Sequence[str], times: int, chance: random.Random) -> Iterator[PowerCut]:
    """Cut the power at random instants, in the order of time.

    Args:
        folder: Folder that was empty, and in which everything was written.
        calls: System calls, from `syscall_trace.trace_journal`.
        times: Number of cuts.
        chance: Source of the instants, and of the data that has reached the disk.

    Yields:
        State after each cut.
    """
    first = next(number for number, line in enumerate(calls) if _hex(str(folder)) in line)
    disk, done = _Disk(folder), 0
    for instant in sorted(chance.randint(first, len(calls)) for _ in range(times)):
        for line in calls[done:instant]:
            disk.replay(line)
        done = instant
        yield PowerCut(instant, disk.after_a_cut(chance), list(disk.acknowledged))


@dataclass(eq=False)
class _Inode:
    """File: its writes in order, as offset and bytes, or a length to which it was cut; and how many are durable."""

    writes: list[tuple[int, bytes | None]] = field(default_factory=list)
    synced: int = 0

    @property
    def length(self) -> int:
        return max((offset + len(data) for offset, data in self.writes if data is not None), default=0)

    def after_a_cut(self, chance: random.Random) -> bytes:
        """Return the content on the disk: all synchronised writes, and of the others random sectors."""
        content = bytearray()
        for number, (offset, data) in enumerate(self.writes):
            durable = number < self.synced
            if data is None:
                if durable or chance.random() < 0.5:
                    del content[offset:]
                continue
            for start in range(0, len(data), SECTOR):
                if durable or chance.random() < 0.5:
                    piece, at = data[start : start + SECTOR], offset + start
                    content.extend(b"\0" * (at - len(content)))
                    content[at : at + len(piece)] = piece
        return bytes(content)


_Names = dict[str, _Inode]


class _Disk:
    """Folder whose files are written, synchronised, renamed and removed.

    Its names in every state that they had are kept, and the index of the last state that is durable.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)
        self._names: _Names = {}
        self._states: list[_Names] = [{}]
        self._durable = 0
        self._syncing: dict[str, tuple[str, int]] = {}
        self.acknowledged: list[int] = []

    def replay(self, line: str) -> None:
        """Replay one line of the recording: a call, or its beginning, or its end."""
        if ended := _ENDED.match(line):
            self._end(ended[1], ended[2], int(ended[3]))
        elif (begun := _LINE.match(line)) and "= -1 " not in line:
            self._begin(begun[1], begun[2], begun[3])
            if "<unfinished" not in line:
                self._end(begun[1], begun[2], 0)

    def after_a_cut(self, chance: random.Random) -> dict[str, bytes]:
        """Return the content of all files by name."""
        names = chance.choice(self._states[self._durable :])
        return {Path(path).name: inode.after_a_cut(chance) for path, inode in names.items()}

    def _begin(self, thread: str, call: str, arguments: str) -> None:
        """Begin a call: its writes may be on the disk from now on."""
        texts = [bytes.fromhex(text.replace("\\x", "")) for text in _TEXT.findall(arguments)]
        described = _DESCRIPTOR.match(arguments)
        number, path = (
            (described[1], bytes.fromhex(described[2].replace("\\x", "")).decode()) if described else ("", "")
        )
        if call == "write" and number == ACKNOWLEDGED:
            self.acknowledged += [int(line) for line in texts[0].split()]
        elif call in ("write", "pwrite64", "ftruncate") and (inode := self._names.get(path)) is not None:
            self._write(inode, call, arguments, texts)
        elif call in ("fsync", "fdatasync"):
            inode = self._names.get(path)
            self._syncing[thread] = (path, len(inode.writes) if inode is not None else len(self._states) - 1)
        elif call in ("openat", "rename", "unlink"):
            self._rename(call, arguments, [text.decode() for text in texts])

    def _end(self, thread: str, call: str, result: int) -> None:
        """End a call: a sync makes durable what had been written, or named, when it began."""
        if call not in ("fsync", "fdatasync") or result != 0:
            return
        path, before = self._syncing.pop(thread)
        if path == self._folder:
            self._durable = max(self._durable, before)
        elif (inode := self._names.get(path)) is not None:
            inode.synced = max(inode.synced, before)

    def _write(self, inode: _Inode, call: str, arguments: str, texts: list[bytes]) -> None:
        numbers = [int(number) for number in _NUMBER.findall(arguments)]
        if call == "ftruncate":
            inode.writes.append((numbers[-1], None))
        else:
            inode.writes.append((numbers[-1] if call == "pwrite64" else inode.length, texts[0]))

    def _rename(self, call: str, arguments: str, paths: list[str]) -> None:
        # SQLite rebuilds its shared-memory index (-shm), which never has to survive a power cut.
        if not all(path.startswith(f"{self._folder}/") for path in paths) or paths[0].endswith("-shm"):
            return
        if call == "openat" and "O_CREAT" in arguments and paths[0] not in self._names:
            self._names[paths[0]] = _Inode()
        elif call == "rename":
            self._names[paths[1]] = self._names.pop(paths[0])
        elif call == "unlink":
            self._names.pop(paths[0], None)
        self._states.append(dict(self._names))


def _hex(text: str) -> str:
    return "".join(f"\\x{byte:02x}" for byte in text.encode())
