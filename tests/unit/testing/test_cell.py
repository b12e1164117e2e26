"""A cell as a process: the settings of its daemon, and its journal."""

from __future__ import annotations

import asyncio
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import DeviceError
from pcmrs.journal import Journal
from pcmrs.service import Ready
from pcmrs.settings import read_settings
from pcmrs.testing.cell import QUICK, REAL_TIME, RunningCell, open_cell
from tests.unit.journal.journal_rows import intent, outcome


def cell_of(folder: Path) -> RunningCell:
    """Return a cell of which nothing but its files exists."""
    ready = Ready(f"pcmrs/lab/{folder.name}", "", {}, str(folder), str(folder / "journal.sqlite"), "ratms", 5.0)
    absent: Any = None
    return RunningCell(absent, ready, (), folder, folder / "log", absent, absent, absent, absent)


async def test_settings_of_a_test_come_after_those_of_every_test(tmp_path: Path) -> None:
    """The last one of a key counts."""
    program = f"import sys; open({str(tmp_path / 'words')!r}, 'w').write('\\n'.join(sys.argv[1:]))"
    with pytest.raises(DeviceError, match="did not start"):
        async with open_cell(tmp_path / "c7", ["cell.rate=2"], prefix=(sys.executable, "-c", program)):
            raise AssertionError
    words = (tmp_path / "words").read_text().split("\n")
    settings = [word for before, word in pairwise(words) if before == "--set"]
    assert [each for each in settings if each.startswith("cell.rate=")] == ["cell.rate=5", "cell.rate=2"]
    assert set(QUICK) < set(settings)
    read = read_settings(overrides=settings)
    assert (read.cell.name, read.cell.folder, read.cell.rate) == ("c7", str(tmp_path / "c7"), 2.0)


@pytest.mark.parametrize("overrides", [QUICK, (*QUICK, *REAL_TIME)])
def test_quick_and_real_time_settings_are_accepted(overrides: tuple[str, ...]) -> None:
    assert read_settings(overrides=overrides).cell.rate == (1.0 if overrides is not QUICK else 5.0)


def test_rows_are_read_from_the_file_while_it_is_written(tmp_path: Path) -> None:
    async def write() -> None:
        cell, journal = cell_of(tmp_path), Journal.open(tmp_path / "journal.sqlite", durable=False)
        assert (cell.rows(), cell.last_row()) == ([], 0)
        await journal.append([intent("a"), outcome("a")])
        last = cell.last_row()
        await journal.append([intent("b")])
        assert [row.command_id for row in cell.rows()] == ["a", "a", "b"]
        assert [row.command_id for row in cell.rows(after=last)] == ["b"]
        await journal.close()

    asyncio.run(write())


def test_name_and_log_are_those_of_the_cell(tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(b"ready \xff\n")
    cell = cell_of(tmp_path)
    assert cell.name == tmp_path.name
    assert cell.log == "ready \N{REPLACEMENT CHARACTER}\n"
