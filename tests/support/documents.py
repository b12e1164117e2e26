"""What the documents promise and cite, as their tables and text say it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from tests import ROOT

DOCS = ROOT / "docs"
NAMED = re.compile(r"`([\w/]+\.py)::(test_\w+)`(?: \((nightly|browser)\))?")
NONE = re.compile(r"none: .+")
CODE = re.compile(r"`(\w+)`")
ROW = re.compile(r"\b[OSBNPTCAQ]\d{1,2}\b")


class Cited(NamedTuple):
    """A test that a document names.

    Attributes:
        file: Below ``tests``.
        only: What the document says of it: ``nightly`` or ``browser`` if ``make test`` has no instance of it.
    """

    file: str
    test: str
    only: str


class Promise(NamedTuple):
    """A requirement or promise of a document, and what it is proved by.

    Attributes:
        id: Unique over all documents.
        rows: Rows of the fault campaign.
        watched: Invariants of the explorer, or ``none: `` and why.
        without: Mutants, or ``none: `` and why.
    """

    id: str
    text: str
    tests: list[Cited]
    rows: list[str]
    watched: str
    without: str


class Source(NamedTuple):
    """A table of a document; the last columns are tests, invariants and mutants, or tests alone.

    Attributes:
        letter: Before the number of a row, where a row has no id of its own.
    """

    page: str
    heading: str
    letter: str
    text: int
    shown: int
    proved: bool = True


SOURCES = (
    Source("safety.md", "Requirements and their tests", "", 1, 3),
    Source("semantics.md", "What holds", "F", 1, 2),
    Source("supervision.md", "What is promised", "V", 0, 1),
    Source("threat-model.md", "Threats from a network", "", 1, 4, proved=False),
    Source("threat-model.md", "Threats on the machine", "", 1, 4, proved=False),
)


def rows_of(text: str, heading: str) -> list[list[str]]:
    """Cells of the tables under a heading, without their heads."""
    section = text.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|") and not line.startswith("| ---")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[1:]]


def cited(text: str) -> list[Cited]:
    """Tests that a document names, in its order."""
    return [Cited(each[1], each[2], each[3] or "") for each in NAMED.finditer(text)]


def promises(source: Source) -> list[Promise]:
    """Promises of a table, in its order."""
    return [
        Promise(
            id=f"{source.letter}{number}" if source.letter else cells[0],
            text=cells[source.text].replace("](#", f"]({source.page}#"),
            tests=cited(cells[source.shown]),
            rows=ROW.findall(NAMED.sub("", cells[source.shown])),
            watched=cells[source.shown + 1] if source.proved else "",
            without=cells[source.shown + 2] if source.proved else "",
        )
        for number, cells in enumerate(rows_of((DOCS / source.page).read_text(), source.heading), start=1)
    ]


def documents() -> list[Path]:
    """All pages that cite tests."""
    return [
        *(ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md", "README.md", "SECURITY.md")),
        *sorted(DOCS.glob("*.md")),
        *sorted((ROOT / "deploy").rglob("*.md")),
    ]
