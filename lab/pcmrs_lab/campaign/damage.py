"""Ways to damage a journal: one of its files is removed or ends early, or one of its bits is another one."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from pcmrs.testing.journal import HEAD, NAME, contents
from pcmrs_lab.campaign.sham import is_sham

TAIL = 2048
"""So many bytes at the end of database and log are damaged one by one."""

TAILED = (NAME, f"{NAME}-wal", HEAD)


class Damage(msgspec.Struct, frozen=True):
    """One change of one file: it ends before `place`, or the bit `flip` of the byte there is another one.

    Attributes:
        file: Its name.
        place: In it; -1 for a file that is removed.
        flip: Number of a bit, from 0; None for a cut.
    """

    file: str
    place: int
    flip: int | None = None

    def apply(self, folder: Path) -> None:
        """Changes the file in the folder; in a sham campaign nothing."""
        if is_sham():
            return
        path = folder / self.file
        content = bytearray(path.read_bytes())
        if self.flip is not None:
            content[self.place] ^= 1 << self.flip
        elif self.place < 0:
            path.unlink()
            return
        else:
            del content[self.place :]
        path.write_bytes(content)

    def __str__(self) -> str:
        if self.flip is not None:
            return f"{self.file} bit {self.flip} flipped in byte {self.place}"
        return f"{self.file} removed" if self.place < 0 else f"{self.file} cut at byte {self.place}"


def damages(
    wholes: Sequence[Path], count: int | None, generator: random.Random, *, flips: bool
) -> list[tuple[Path, Damage]]:
    """Damages of the journals in these folders.

    Args:
        wholes: Folder of a journal each.
        count: So many random ones, in any file; None for every byte of the head's slots and of the tails of the others.
        generator: Of what is random.
        flips: Bits are flipped; otherwise files are cut.
    """
    first = 0 if flips else -1
    if count is None:
        places = [(whole, file, place) for whole in wholes for file, place in _tails(whole)]
    else:
        files = [(whole, file, len(content)) for whole in wholes for file, content in sorted(contents(whole).items())]
        chosen = [generator.choice(files) for _ in range(count)]
        places = [(whole, file, generator.randrange(first, length)) for whole, file, length in chosen]
    return [(whole, Damage(file, place, generator.randrange(8) if flips else None)) for whole, file, place in places]


def _tails(folder: Path) -> Iterator[tuple[str, int]]:
    for name in TAILED:
        content = (folder / name).read_bytes() if (folder / name).exists() else b""
        if name == HEAD:
            yield from ((name, place) for place, byte in enumerate(content) if byte)  # the rest is padding
        else:
            yield from ((name, place) for place in range(max(0, len(content) - TAIL), len(content)))
