"""The guards that are taken out of the product one at a time, and how: tables in ``listed``, one for each topic."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec

from tests.mutants.places import Place, find

TABLES = Path(__file__).parent / "listed"


class Mutant(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The product without one of its guards.

    Attributes:
        name: Unique.
        module: Dotted name below ``pcmrs``; other modules begin with ``pcmrs_sim`` or ``pcmrs_lab``.
        function: Qualified name of the function or class; empty for statements of the module itself.
        guard: Its exact text, which occurs once in the function.
        without: The text that takes its place.
        harm: The possible consequence.
        requirement: Id of the requirement or promise of the documents that it breaks; their tables must name it there.
    """

    name: str
    module: str
    function: str
    guard: str
    without: str
    harm: str
    requirement: str = ""

    def place(self, tree: Path) -> Place:
        """Find the guard.

        Raises:
            ValueError: Its function or its text is not there, or not only once.
        """
        try:
            return find(tree, self.module, self.function, self.guard)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None


def listed() -> list[Mutant]:
    """Return all mutants of all tables."""
    return [
        msgspec.convert(entry, Mutant)
        for path in sorted(TABLES.rglob("*.toml"))
        for entry in tomllib.loads(path.read_text())["mutant"]
    ]
