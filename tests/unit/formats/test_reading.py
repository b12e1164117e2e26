"""Untrusted files are read up to a limit, or refused with a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.landmarks import read_landmarks
from pcmrs.formats.reading import read_bytes, read_table, read_yaml


def test_files_that_are_not_there_huge_or_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"none\.yaml cannot be read: No such file"):
        read_landmarks(tmp_path / "none.yaml")
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_landmarks(tmp_path / "folder.yaml")
    (tmp_path / "huge.csv").write_bytes(b"0" * 2_000_000)
    with pytest.raises(FileFormatError, match="longer than"):
        read_landmarks(tmp_path / "huge.csv")
    (tmp_path / "bytes.csv").write_bytes(b"name,x_mm\xff")
    with pytest.raises(FileFormatError, match="byte 9 is 0xff"):
        read_landmarks(tmp_path / "bytes.csv")


def test_a_file_of_the_largest_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(b"1" * 10)
    assert read_bytes(path, 10) == b"1" * 10
    with pytest.raises(FileFormatError, match="longer than 9 bytes") as refused:
        read_bytes(path, 9)
    assert refused.value.fields == {"file": str(path), "limit": 9}


def test_a_path_that_no_file_can_have_is_refused() -> None:
    with pytest.raises(FileFormatError, match="cannot be read: embedded null byte"):
        read_bytes(Path("a\0b"), 10)


def test_yaml_refuses_a_key_given_twice_at_any_depth(tmp_path: Path) -> None:
    path = tmp_path / "pose.yaml"
    path.write_text("POSE: {x: 1, y: 2}\nOTHER:\n  x: 1\n  x: 2\n")
    with pytest.raises(FileFormatError, match=r"the key x is given twice.*line 3"):
        read_yaml(path)
    path.write_text("POSE: {x: 1}\nOTHER: {x: 2}\n")
    assert read_yaml(path).keys == {"POSE": {"x": 1}, "OTHER": {"x": 2}}


def test_a_row_of_a_table_has_the_line_it_is_in(tmp_path: Path) -> None:
    """Blank lines are skipped, columns are in lower case, and short rows lack cells."""
    path = tmp_path / "table.csv"
    path.write_text("\ufeffName, X \n\n , \na, 1\n\nb\n", encoding="utf-8")
    assert read_table(path) == (["name", "x"], [(4, {"name": "a", "x": "1"}), (6, {"name": "b"})])
    path.write_text("")
    assert read_table(path) == ([], [])


@pytest.mark.parametrize("number", ["0x" + "f" * 5000, "1" * 5000, "-0b1" + "0" * 70])
def test_yaml_refuses_an_integer_that_cannot_be_printed(tmp_path: Path, number: str) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(f"x: {number}\n")
    with pytest.raises(FileFormatError, match="is not YAML"):
        read_yaml(path)


def test_yaml_reads_integers_of_64_bits(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(f"x: {2**63 - 1}\ny: -0x10\n")
    assert read_yaml(path).keys == {"x": 2**63 - 1, "y": -16}
