"""What this version does with each file that a cell keeps, of its own, of earlier and of later versions."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from pcmrs.calibration import read_calibration
from pcmrs.errors import PcmrsError
from pcmrs.maintenance import check_folder, check_named_files
from pcmrs.pki import read_register
from pcmrs.recording.file import FORMAT, FORMAT_KEY, RecordingFile, Topics
from pcmrs.recording.reader import check_format
from pcmrs.settings import read_settings
from pcmrs.workflows import find_workflow
from tests.unit.maintenance.labs import VERSIONS, Lab, contents, unpacked


def formats(lab: Lab) -> dict[str, tuple[int, str]]:
    """Version and action of each file in the cell's folder by its kind."""
    return {file.kind: (file.format, file.action) for file in check_folder(lab.cell).files}


def test_formats_of_the_first_version_are_read_and_explained(first: Lab) -> None:
    before = contents(first.folder)
    assert formats(first) == {
        "folder of a cell": (1, "upgrade"),
        "journal": (2, "upgrade"),
        "counters of signed peers": (1, "use"),
        "recording": (1, "use"),
    }
    assert check_folder(first.cell).action == "upgrade"
    assert contents(first.folder) == before


def test_formats_of_this_version_are_used_as_they_are(present: Lab) -> None:
    assert formats(present) == {
        "folder of a cell": (2, "use"),
        "journal": (3, "use"),
        "counters of signed peers": (1, "use"),
        "recording": (1, "use"),
    }
    assert check_folder(present.cell).action == "use"


@pytest.mark.parametrize("version", VERSIONS)
def test_configuration_and_register_of_each_version_are_read(version: str, tmp_path: Path) -> None:
    lab = unpacked(version, tmp_path)
    files: list[tuple[str, Path, Callable[[Path], object]]] = [
        ("configuration", lab.configuration, read_settings),
        ("calibration", lab.folder / "pointer.toml", read_calibration),
        ("register", lab.folder / "pki" / "register.json", read_register),
    ]
    assert [(file.text, file.action) for file in check_named_files(files)] == [("", "use")] * 3


def test_a_tool_calibration_of_the_first_version_is_refused(first: Lab) -> None:
    """It took the marker body for the contact point."""
    (found,) = check_named_files([("calibration", first.folder / "tool.toml", read_calibration)])
    assert found.action == "refuse"
    assert "pcmrs calibrate hand-eye" in found.text
    assert "pcmrs calibrate tip" in found.text


def of_version(number: int) -> Callable[[Path], None]:
    def change(journal: Path) -> None:
        with closing(sqlite3.connect(journal)) as connection:
            connection.execute(f"PRAGMA user_version = {number}")

    return change


@pytest.mark.parametrize(
    ("name", "change", "found"),
    [
        ("cell.json", lambda path: path.write_text('{"format": 3}'), "format 3"),
        ("ratms.sqlite", of_version(4), "journal version 4"),
        (
            "peers.counters",
            lambda path: path.write_bytes(path.read_bytes().replace(b"PCMRSPC1", b"PCMRSPC2")),
            "format PCMRSPC2",
        ),
    ],
    ids=["folder", "journal", "counters"],
)
def test_a_file_of_a_later_version_refuses_the_folder(
    present: Lab, name: str, change: Callable[[Path], None], found: str
) -> None:
    change(present.cell / name)
    checked = check_folder(present.cell)
    assert checked.action == "refuse"
    assert [found in file.text for file in checked.refused] == [True]


@pytest.mark.parametrize(
    ("name", "change", "read"),
    [
        ("cell.toml", lambda text: b"schema = 2\nnew_table_of_later = 1\n" + text, read_settings),
        ("pointer.toml", lambda text: text.replace(b"schema = 1", b"schema = 2"), read_calibration),
        ("pki/register.json", lambda text: b'{"schema": 2, "identities": ' + text + b"}", read_register),
    ],
    ids=["configuration", "calibration", "register"],
)
def test_a_named_file_of_a_later_version_is_refused(
    present: Lab, name: str, change: Callable[[bytes], bytes], read: Callable[[Path], object]
) -> None:
    path = present.edit(name, change)
    with pytest.raises(PcmrsError, match=r"2, and this version of PCMRS reads 1.*later one"):
        read(path)


def test_a_recording_of_a_later_version_is_not_played(tmp_path: Path) -> None:
    for number in (FORMAT, FORMAT + 1):
        path = tmp_path / f"{number}.mcap"
        RecordingFile(path, Topics(), {"cell": "c", FORMAT_KEY: str(number)}).close()
    check_format(tmp_path / f"{FORMAT}.mcap")
    with pytest.raises(PcmrsError, match=f"has format {FORMAT + 1}"):
        check_format(tmp_path / f"{FORMAT + 1}.mcap")


def test_a_cut_recording_refuses_no_folder(first: Lab) -> None:
    (recording,) = (first.cell / "recordings").glob("*.mcap")
    recording.write_bytes(recording.read_bytes()[:3])
    assert check_folder(first.cell).action == "upgrade"


def test_rows_of_version_2_that_no_head_names_are_refused(version_2_behind: Lab) -> None:
    (refused,) = check_folder(version_2_behind.cell).refused
    assert "1 rows after the last one that its signed head names" in refused.text
    assert "Start the version of PCMRS that wrote them once" in refused.text


def test_a_journal_of_an_unknown_blueprint_names_the_migration(present: Lab, tmp_path: Path) -> None:
    changed = tmp_path / "ratms.toml"
    text = find_workflow("ratms").blueprint.read_text()
    changed.write_text(re.sub(r"\[\[migrations\]\]\n(?:\w+ = .*\n)+", "", text))
    (refused,) = check_folder(present.cell, str(changed)).refused
    assert "[[migrations]]" in refused.text


def test_a_folder_above_a_cell_is_refused(present: Lab) -> None:
    (refused,) = check_folder(present.folder).refused
    assert (refused.kind, refused.format) == ("folder of a cell", 0)
    assert "cell/cell.json below it" in refused.text
