"""A report's page as a test reads it: parsed, with its text and its tables."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

from click.testing import CliRunner

from pcmrs.cli import main
from tests.unit.report.report_journals import Row

VOID = {"meta", "img", "br"}
"""Elements of the page that have no end."""


class Page(HTMLParser):
    """Parses a page and refuses what is not well-formed.

    Attributes:
        names: Of all elements.
        attributes: Of all elements, name and value.
        words: All text in order, without styles.
        cells: Rows of all tables, cell by cell.
    """

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.names: set[str] = set()
        self.attributes: list[tuple[str, str]] = []
        self.cells: list[list[str]] = []
        self._texts: list[str] = []
        self._open: list[str] = []
        self.feed(page)
        self.close()
        assert self._open == [], f"not closed: {self._open}"

    @property
    def words(self) -> str:
        """All text, its spaces made one each."""
        return " ".join("".join(self._texts).split())

    def rows(self, columns: int) -> list[list[str]]:
        """The rows of the tables with so many columns, without their heads."""
        return [cells for cells in self.cells if len(cells) == columns][1:]

    def value(self, name: str) -> str:
        """What stands after a name in a table of facts."""
        cells = next(cells for cells in self.cells if name in cells)
        return cells[cells.index(name) + 1]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        self._texts.append(" " if tag not in ("b", "code", "small") else "")
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        assert self._open[-1] == tag, f"</{tag}> closes <{self._open[-1]}>"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        if "style" in self._open:
            return
        self._texts.append(data)
        if "td" in self._open or "th" in self._open:
            self.cells[-1][-1] = " ".join(f"{self.cells[-1][-1]}{data}".split())


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, ["report", *map(str, words)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def page_of(source: Path, *words: object, status: int = 0) -> Page:
    output = source.parent / "page.html"
    assert run(source, "-o", output, *words)[0] == status
    return Page(output.read_text())


def outcomes(rows: list[Row], *decisions: str) -> list[tuple[int, Row]]:
    """Sequence and row of what ended so."""
    found = [(number, row) for number, row in enumerate(rows, 1) if row["kind"] == "outcome"]
    return [(number, row) for number, row in found if row["verdict"]["decision"] in decisions]


def name(row: Row) -> str:
    return f"{row['branch']}.{row['operation']}"


def shown(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}".replace("-", "−")
