"""The guards that are taken out of the product one at a time, and how: a table beside this file for each package."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec

FOLDER = Path(__file__).parent
TREE = FOLDER.parents[1]


class Mutant(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The product without one of its guards.

    Attributes:
        name: Unique.
        file: Of the product, below ``pcmrs``.
        guard: Its exact text, which occurs once in the file.
        without: What stands there instead.
        harm: What could go wrong then.
        tests: Files below ``tests``, or single tests of a long one, of which at least one must fail then.
    """

    name: str
    file: str
    guard: str
    without: str
    harm: str
    tests: tuple[str, ...]

    def altered(self, tree: Path) -> str:
        """The source without the guard.

        Raises:
            ValueError: The guard's text is not there, or not only once.
        """
        source = (tree / "pcmrs" / self.file).read_text()
        found = source.count(self.guard)
        if found != 1:
            raise ValueError(f"{self.name}: its guard occurs {found} times in {self.file}, not once.")
        return source.replace(self.guard, self.without)


def declared() -> list[Mutant]:
    """All mutants of all tables."""
    return [
        msgspec.convert(table, Mutant)
        for path in sorted(FOLDER.glob("*.toml"))
        for table in tomllib.loads(path.read_text())["mutant"]
    ]
