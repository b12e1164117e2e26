"""Tables: text from outside can neither control the terminal nor load anything."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from rich.table import Table

from pcmrs.cli.tables import NARROWEST, Terminal, print_report, save_svg

NASTY = "\x1b[2Jall is well\r\x07‮\nforged"


class Report(msgspec.Struct):
    name: str
    value: float | None = None


def test_a_table_shows_no_control_character_of_its_cells(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("name")
    table.add_row(NASTY)
    Terminal(width=NARROWEST).print(table)
    assert "\x1b[2J" not in capsys.readouterr().out


def test_a_narrow_terminal_cuts_no_number(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    table = Table(*(f"column {number}" for number in range(6)))
    table.add_row(*(f"{number}.123456789" for number in range(6)))
    print_report(Report("a"), table, as_json=False)
    shown = capsys.readouterr().out
    assert all(f"{number}.123456789" in shown for number in range(6))
    print_report(Report("a"), table, as_json=True)
    assert json.loads(capsys.readouterr().out) == {"name": "a", "value": None}


def test_a_picture_of_a_table_loads_nothing(tmp_path: Path) -> None:
    table = Table("mm")
    table.add_row("0.123")
    save_svg(table, tmp_path / "table.svg")
    svg = (tmp_path / "table.svg").read_text(encoding="utf-8")
    assert "0.123" in svg
    assert "url(http" not in svg.replace('"', "")
    assert "@font-face" not in svg
    with pytest.raises(OSError, match="none"):
        save_svg(table, tmp_path / "none" / "table.svg")
