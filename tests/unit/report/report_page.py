"""A report's page as a test reads it: parsed, with its text and its tables."""

from __future__ import annotations

from html.parser import HTMLParser

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
