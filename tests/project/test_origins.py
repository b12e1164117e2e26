"""The page of settings says where every default comes from."""

from __future__ import annotations

import re
import sys
from fnmatch import fnmatchcase

from tests import ROOT

sys.path.append(str(ROOT / "docs" / "hooks"))

from origins import PATTERNS, full_name
from site_reference import settings

_TABLE = re.compile(r"^## (?:`\[(.*)\]`|The root) ")
_ROW = re.compile(r"^\| `(\w+)` \| (.*) \|$")


def rows() -> list[tuple[str, list[str]]]:
    """Dotted name of every key of the page, and the other cells of its row."""
    found, table = [], ""
    for line in "\n".join(settings()).splitlines():
        if heading := _TABLE.match(line):
            table = heading[1] or ""
        elif row := _ROW.match(line):
            found.append((full_name(table, row[1]), re.split(r"(?<!\\) \| ?", row[2])))
    return found


ROWS = rows()


def test_every_default_has_an_origin() -> None:
    assert len(ROWS) > 300
    assert [
        name for name, cells in ROWS if not (cells[1] == "needed" or _is_table(cells[0]) or cells[-1].strip())
    ] == []


def _is_table(kind: str) -> bool:
    """A link to the type of a table, whose keys have their own rows."""
    return kind.startswith("[")


def test_no_origin_is_of_a_key_that_there_is_not() -> None:
    names = [name for name, _ in ROWS]
    assert [pattern for pattern, _ in PATTERNS if not any(fnmatchcase(name, pattern) for name in names)] == []
