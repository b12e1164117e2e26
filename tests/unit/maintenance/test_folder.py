"""The folder of a cell: a daemon uses one of its own version, marks a new one, and refuses all others unchanged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.maintenance import FORMAT, enter_folder, hold_folder
from pcmrs.maintenance._folder import MANIFEST, MARKER, read_format
from tests.unit.maintenance.labs import Lab, contents


def test_a_new_folder_gets_the_format_of_this_version(tmp_path: Path) -> None:
    assert read_format(tmp_path).format == 1
    enter_folder(tmp_path)
    assert read_format(tmp_path).format == FORMAT
    marked = (tmp_path / MARKER).read_bytes()
    enter_folder(tmp_path)
    assert (tmp_path / MARKER).read_bytes() == marked


def test_a_folder_of_the_first_version_needs_an_upgrade(first: Lab) -> None:
    before = contents(first.cell)
    with pytest.raises(ConfigurationError, match=r"ratms.sqlite \(format 2\).*`pcmrs upgrade --check") as refused:
        enter_folder(first.cell)
    assert refused.value.fields["journals"] == {"ratms.sqlite": 2}
    assert contents(first.cell) == before


def test_a_folder_of_a_later_version_is_refused_unchanged(present: Lab) -> None:
    present.edit("cell/cell.json", lambda _: json.dumps({"format": FORMAT + 1, "program": "9.1", "more": 1}).encode())
    before = contents(present.cell)
    with pytest.raises(ConfigurationError, match=r"format 3.* 1 to 2: PCMRS 9.1 wrote it.*backup"):
        enter_folder(present.cell)
    assert contents(present.cell) == before


def test_a_backup_is_no_cell(present: Lab) -> None:
    (present.cell / MANIFEST).write_text("{}")
    with pytest.raises(ConfigurationError, match=r"is a backup.*pcmrs restore"):
        enter_folder(present.cell)


@pytest.mark.parametrize("content", [b"", b"[]", b'{"format": "2"}'], ids=["empty", "list", "text"])
def test_an_unreadable_format_is_no_guess(tmp_path: Path, content: bytes) -> None:
    (tmp_path / MARKER).write_bytes(content)
    with pytest.raises(ConfigurationError, match="does not say which format"):
        enter_folder(tmp_path)
    assert (tmp_path / MARKER).read_bytes() == content


def test_a_damaged_journal_of_another_workflow_is_not_judged(tmp_path: Path) -> None:
    (tmp_path / "femoroplasty.sqlite").write_bytes(b"no database")
    enter_folder(tmp_path)
    assert read_format(tmp_path).format == FORMAT


def test_one_program_at_a_time_holds_a_folder(tmp_path: Path) -> None:
    with (
        hold_folder(tmp_path / "cell"),
        pytest.raises(ConfigurationError, match="Another daemon runs this cell"),
        hold_folder(tmp_path / "cell"),
    ):
        pytest.fail("It is held twice.")
    with hold_folder(tmp_path / "cell"):
        assert (tmp_path / "cell").stat().st_mode & 0o777 == 0o700
